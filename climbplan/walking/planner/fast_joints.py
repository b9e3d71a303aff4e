"""Why a robot with joints has no walk: whether its motors are too slow, and by how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.walking.check.speed import leg_speeds
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.task.task import WalkTask


def too_fast(task: WalkTask, solve: Callable[[WalkTask], WalkAnswer]) -> str:
    """What a walk by motors of any speed would ask for; empty where they are not the reason.

    solve: the task by the method that found nothing.
    """
    if task.legs is None:
        return ""
    legs = task.legs
    endless = replace(legs, max_speed=np.full_like(legs.max_speed, np.inf))
    found = solve(replace(task, legs=endless)).trajectory
    if found is None:
        return ""
    share = leg_speeds(legs, task, found).speed / legs.max_speed
    n, leg, joint = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[n, leg, joint] > 1.0:
        return ""
    return (
        f"joints are too slow: a walk is found for motors of any speed, it asks "
        f"{legs.chain.names[leg][joint]} of {task.body.leg_names[leg]} for "
        f"{share[n, leg, joint]:.2g} times its {legs.max_speed[leg, joint]:.3g} rad/s at "
        f"{task.step * n:.2f} s; a slower task.reference.velocity (and task.start.velocity) or "
        "less task.lift ask for less"
    )
