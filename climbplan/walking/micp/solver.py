"""The method `spatial-branch-and-bound`: a better walk, and a lower bound on walks near it.

The bound is on motions within attitude boxes by forward Euler steps, which the mixed-integer
program relaxes. For a task with another integrator the program only proposes gaits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.walking.micp.branch_and_bound import BranchAndBound
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.parallel import bound_in_parallel
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.task.task import WalkTask


def solve_micp(
    task: WalkTask, limits: MicpLimits, warm: WalkAnswer, other_starts: Sequence[WalkAnswer] = ()
) -> WalkAnswer:
    """Improve the cheapest of known walks by spatial branch and bound, and bound its cost.

    Args:
        task: The task.
        limits: Widths of the attitude boxes, relative gap and time limit.
        warm: The walk to start from; it may have no trajectory.
        other_starts: Walks that widen the attitude boxes, and may be cheaper.

    Returns:
        The best walk with its lower bound; no bound unless the integrator is forward Euler.
    """
    answers = [answer for answer in (warm, *other_starts) if answer.trajectory is not None]
    cheapest = min(answers, key=lambda answer: answer.objective, default=warm)
    start = cheapest.trajectory
    if start is None:
        return WalkAnswer(None, np.inf, warm.seconds, f"nothing to start from: {warm.word}")
    euler_task = replace(task, integrator="euler")
    motions = [answer.trajectory.state for answer in answers if answer.trajectory is not None]
    run = BranchAndBound(task, euler_task, limits, start, cheapest.objective, limits.clock())
    while run.seconds_left > 0 and not run.is_closed:
        cells = run.build_cells(np.stack([run.incumbent.state, *motions]))
        if limits.processes > 1:
            bound_in_parallel(run, cells)
        else:
            run.bound_cells(cells)
        # A much better incumbent narrows all bounds, and moves the attitude boxes.
        if not run.needs_restart:
            break
    has_bound = task.integrator == euler_task.integrator
    if not has_bound:
        run.history = [replace(entry, bound=-np.inf) for entry in run.history]
    return WalkAnswer(
        run.incumbent,
        run.objective,
        run.seconds,
        _describe(task, run, len(motions), bool(other_starts), has_bound),
        bound=min(run.bound, run.objective) if has_bound else None,
        tried=len(run.tried_gaits),
        tubes=len(run.bounds) if has_bound else 0,
        initial_plan=start,
        history=tuple(run.history),
    )


def _describe(
    task: WalkTask, run: BranchAndBound, num_motions: int, has_others: bool, has_bound: bool
) -> str:
    """Return the message of the answer: what the bound is of, or why there is none."""
    if not has_bound:
        return (
            "no bound: the program relaxes forward Euler steps, and its gaits are solved by "
            f"{task.integrator} steps; {run.message}"
        )
    limits = run.limits
    width = np.rad2deg(limits.angles).round(3)
    source = f"what {num_motions} searches found" if has_others else "the start's attitude"
    boxes = f"{len(run.bounds)} attitude boxes; " if len(run.bounds) > 1 else ""
    return (
        f"bound of motions within {width[0]:g}, {width[1]:g}, {width[2]:g} degrees and "
        f"{limits.spin[0]:g}, {limits.spin[1]:g}, {limits.spin[2]:g} rad/s of {source} "
        f"or the reference; {boxes}{run.message}"
    )
