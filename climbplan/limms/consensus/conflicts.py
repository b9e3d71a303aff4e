"""Why the mixed-integer block reaches no goal: what, loosened one at a time, lets it.

First the limits of the spec, then blocks of rows that no single number loosens.
"""

from __future__ import annotations

import time
from dataclasses import replace

from climbplan.errors import Conflict
from climbplan.limms.consensus.mixed_integer import NEAR_GOAL, Kind, MixedInteger
from climbplan.limms.consensus.setting import Setting, setting_of

KINDS = {"arms": "arms", "stand": "quadruped that stands", "leap": "quadruped that leaps"}
TRIAL = 100  # looks of HiGHS in each loosened block
_HORIZON = "horizon"  # which no check holds
# Limits of the spec, by the names of the checks that hold them: words, key of the module, factor
_LOOSER = {
    "force.limit": ("force limit (max_force)", "max_force", 10.0),
    "latch.moment": ("latch moment (latch_moment)", "latch_moment", 20.0),
    "joint.speed": ("joint speed (max_joint_speed)", "max_joint_speed", 5.0),
    "ground.speed": ("speed on the ground (ground_speed)", "ground_speed", 5.0),
}
# Blocks of rows that no single number loosens
_BLOCKS = {
    "clear.box": "free space of the box",
    "clear.solids": "free space of modules",
    "kinematics.points": "lengths of links",
    "joint.range": "joint ranges",
    "support.sides": "sides that feet stand on",
}


def conflicts_of(setting: Setting, nearest: dict[Kind, float], deadline: float) -> list[Conflict]:
    """One conflict for each behaviour: how near it comes, and what would let it reach the goal.

    deadline: `time.monotonic` [s], after which nothing more is loosened.
    """
    found = []
    for kind, missed in nearest.items():
        text = f"the box is proved to miss its goal, {missed:.2f} m off in the best plan seen"
        guilty = _guilty(setting, kind, deadline)
        if guilty:
            text += "; it conflicts with the " + " and the ".join(guilty.values())
        names = ("goal.reached", *(name for name in guilty if name != _HORIZON))
        found.append(Conflict(KINDS[kind], (text,), in_words=True, names=names))
    return found


def _guilty(setting: Setting, kind: Kind, deadline: float) -> dict[str, str]:
    """What lets the goal be reached once it is loosened, in words, by the names of checks."""

    def reaches(block: MixedInteger) -> bool:
        block.choose(kind)
        return block.first(TRIAL, deadline).missed <= NEAR_GOAL

    found: dict[str, str] = {}
    scene, intervals, form = setting.scene, setting.intervals, setting.form
    trials = [
        (name, words, replace(scene, module=scene.module.model_copy(update={key: factor * value})))
        for name, (words, key, factor) in _LOOSER.items()
        if (value := float(vars(scene.module)[key]))
    ]
    if kind != "arms":
        rough = replace(scene, friction=10.0 * scene.friction)
        trials.append(("force.friction", "friction of the ground (terrain.friction)", rough))
    trials.append((_HORIZON, f"horizon (solver.admm.intervals = {intervals})", scene))
    for name, words, loose in trials:
        if time.monotonic() > deadline:
            return found
        longer = 2 if name == _HORIZON else 1
        if reaches(MixedInteger(setting_of(loose, longer * intervals, form))):
            found[name] = words
    block = MixedInteger(setting)
    for name in (name for name in block.rows.names.names if name in _BLOCKS):
        if time.monotonic() > deadline:
            return found
        block.loosen(name)
        if reaches(block):
            found[name] = _BLOCKS[name]
        block.restore(name)
    return found
