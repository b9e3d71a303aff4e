"""Why the mixed-integer block reaches no goal: limits that, loosened one at a time, let it."""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import Conflict
from climbplan.limms.consensus.mixed_integer import NEAR_GOAL, Kind, MixedInteger
from climbplan.limms.consensus.setting import setting_of
from climbplan.limms.scene import Scene

KINDS = {"arms": "arms", "stand": "quadruped that stands", "leap": "quadruped that leaps"}
TRIAL = 5.0  # [s] of each loosened block
_LOOSER = {
    "force limit (max_force)": ("max_force", 10.0),
    "latch moment (latch_moment)": ("latch_moment", 20.0),
    "joint speed (max_joint_speed)": ("max_joint_speed", 5.0),
    "speed on the ground (ground_speed)": ("ground_speed", 5.0),
}


def conflicts_of(
    scene: Scene, intervals: int, nearest: dict[Kind, float], deadline: float
) -> list[Conflict]:
    """One conflict for each behaviour: how near it comes, and what would let it reach the goal."""
    found = []
    for kind, missed in nearest.items():
        text = f"the box is proved to miss its goal, {missed:.2f} m off in the best plan seen"
        guilty = _guilty(scene, intervals, kind, deadline)
        if guilty:
            text += "; it conflicts with the " + " and the ".join(guilty)
        found.append(Conflict(KINDS[kind], (text,), (), True))
    return found


def _guilty(scene: Scene, intervals: int, kind: Kind, deadline: float) -> list[str]:
    found = []
    trials = [
        (name, replace(scene, module=scene.module.model_copy(update={key: factor * value})), 1)
        for name, (key, factor) in _LOOSER.items()
        if (value := float(vars(scene.module)[key]))
    ]
    trials.append((f"horizon (solver.admm.intervals = {intervals})", scene, 2))
    for name, loose, longer in trials:
        left = deadline - time.perf_counter()
        if left <= 1.0:
            break
        block = MixedInteger(setting_of(loose, longer * intervals))
        block.choose(kind)
        if block.first(min(TRIAL, left)).missed <= NEAR_GOAL:
            found.append(name)
    return found
