"""What the box's forces ask of the modules: joint torques, and their own weight beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.limms.plan import LimmsPlan
from climbplan.limms.scene import GRAVITY, Array


@dataclass(frozen=True)
class Loads:
    """Largest values over a plan."""

    force: Array  # (L,) [N] that each module passes on
    torque: Array  # (L,) [N m] at its worst joint, from that force alone
    own_weight: float  # [N m] at a joint that holds a whole straight module level
    limit: float  # [N m]


def loads_of(plan: LimmsPlan) -> Loads:
    """Loads of all modules.

    A module without mass carries the same force through all of its joints: the torque about each
    is that of the force at the end on the box, or at the foot of a leg. Latch moments of arms are
    left out.
    """
    motion = plan.motion
    count = len(plan.module_names)
    force, torque = np.zeros(count), np.zeros(count)
    for m in range(count):
        for end, anchors in enumerate((motion.base_anchor[:, m], motion.tip_anchor[:, m])):
            at = np.flatnonzero((anchors >= 0) & (anchors < 4 * len(plan.box_size)))
            if not len(at):
                continue
            box, side = anchors[at] // 4, anchors[at] % 4
            f = motion.force[at, box, side]
            is_leg = motion.mode[at, m] == 4
            points = motion.joint_position[at, m]
            where = np.where(is_leg[:, None], points[:, 7 * (1 - end)], points[:, 7 * end])
            force[m] = max(force[m], float(np.linalg.norm(f, axis=1).max()))
            for joint in range(1, 7):
                axis = motion.joint_rotation[at, m, joint, :, 2 if joint in (1, 4, 6) else 1]
                arm = np.cross(where - points[:, joint], f)
                torque[m] = max(torque[m], float(np.abs((arm * axis).sum(axis=1)).max()))
    length = sum(plan.module["link_lengths"])
    own = plan.module["mass"] * GRAVITY * length / 2
    return Loads(force, torque, float(own), float(plan.module["max_torque"]))
