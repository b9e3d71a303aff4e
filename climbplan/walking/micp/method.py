"""A bound about known motions, and gaits of the relaxation that the true dynamics are solved with.

The bound holds for every motion within the tubes, by forward Euler steps: that is what the program
relaxes. Of a task by `mean` steps it is asked for gaits alone, and no bound is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.walking.micp.abreast import cover_abreast
from climbplan.walking.micp.bounding import Bounding
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.task.task import WalkTask


def solve_micp(
    task: WalkTask, limits: MicpLimits, warm: WalkAnswer, others: Sequence[WalkAnswer] = ()
) -> WalkAnswer:
    """Improve the cheapest of known trajectories, and bound it where steps are Euler's.

    All of them give the tube, and the cheapest the largest cost.
    """
    given = [answer for answer in (warm, *others) if answer.trajectory is not None]
    cheapest = min(given, key=lambda answer: answer.objective, default=warm)
    known = cheapest.trajectory
    if known is None:
        return WalkAnswer(None, np.inf, warm.seconds, f"nothing to start from: {warm.word}")
    stated = replace(task, integrator="euler")
    motions = [answer.trajectory.state for answer in given if answer.trajectory is not None]
    run = Bounding(task, stated, limits, known, cheapest.objective, limits.clock())
    while run.left > 0 and not run.closed:
        leaves = run.leaves(np.stack([run.best.state, *motions]))
        if limits.processes > 1:
            cover_abreast(run, leaves)
        else:
            run.cover(leaves)
        # A much better incumbent is worth a new start: ranges depend on its cost, tubes on it.
        if not run.again:
            break
    width = np.rad2deg(limits.angles).round(3)
    about = f"what {len(motions)} searches found" if others else "the start's attitude"
    tubes = f"{len(run.bounds)} tubes; " if len(run.bounds) > 1 else ""
    word = (
        f"bound of motions within {width[0]:g}, {width[1]:g}, {width[2]:g} degrees and "
        f"{limits.spin[0]:g}, {limits.spin[1]:g}, {limits.spin[2]:g} rad/s of {about} "
        f"or the reference; {tubes}{run.word}"
    )
    proves = task.integrator == stated.integrator
    if not proves:
        run.history = [replace(step, bound=-np.inf) for step in run.history]
        word = (
            "no bound: the program relaxes forward Euler steps, and its gaits are solved by "
            f"{task.integrator} steps; {run.word}"
        )
    return WalkAnswer(
        run.best,
        run.objective,
        run.seconds,
        word,
        bound=min(run.bound, run.objective) if proves else None,
        tried=len(run.seen),
        tubes=len(run.bounds) if proves else 0,
        begun=known,
        history=tuple(run.history),
    )
