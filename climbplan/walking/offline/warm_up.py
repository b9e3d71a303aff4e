"""Compile all kernels of a search before its clock starts."""

from __future__ import annotations

from climbplan.walking.check.checker import is_feasible
from climbplan.walking.offline.gaits import assign_regions, repeat_gait
from climbplan.walking.offline.sqp import solve_gait
from climbplan.walking.task.task import WalkTask

# What is compiled does not depend on numbers, only on what is called.
_done: set[tuple[str, bool]] = set()


def warm_up(task: WalkTask) -> None:
    """Take one gait of a task through a QP and the exact check, once in a process.

    Limits in seconds are on searching, not on compiling, which a machine does once.
    """
    key = task.integrator, task.ground.is_rough
    if key in _done:
        return
    _done.add(key)
    stand = repeat_gait("stand", task.body.leg_count, task.knots)
    answer = solve_gait(task, assign_regions(task, stand), None, 2)
    if answer.trajectory is not None:
        is_feasible(task, answer.trajectory)
