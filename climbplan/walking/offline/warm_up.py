"""Compiled code loaded before any clock runs: with a cold cache that takes some 15 seconds."""

from __future__ import annotations

from climbplan.walking.check.checker import passes
from climbplan.walking.offline.gaits import cycle, with_regions
from climbplan.walking.offline.sqp import solve_gait
from climbplan.walking.task.task import WalkTask

# What is compiled does not depend on numbers, only on what is called.
_done: set[tuple[str, bool]] = set()


def warm_up(task: WalkTask) -> None:
    """Take one gait of a task through a QP and the exact check, once in a process.

    Limits in seconds are on searching, not on compiling, which a machine does once.
    """
    key = task.integrator, task.ground.rough
    if key in _done:
        return
    _done.add(key)
    stand = cycle("stand", task.body.leg_count, task.knots)
    found = solve_gait(task, with_regions(task, stand), None, 2)
    if found.trajectory is not None:
        passes(task, found.trajectory)
