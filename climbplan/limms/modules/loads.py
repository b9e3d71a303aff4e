"""What the box's forces ask of the modules: joint torques, and their own weight beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY


@dataclass(frozen=True)
class Loads:
    """Loads over a plan (T samples, L modules), and what they compare with."""

    force: Array  # (T, L) [N] that each module passes on
    torque: Array  # (T, L) [N m] at its worst joint, from that force alone
    own_weight: float  # [N m] at a joint that holds a whole straight module level
    limit: float  # [N m]


def loads_of(plan: LimmsPlan) -> Loads:
    """Loads of all modules.

    A module without mass carries the same force through all of its joints: the torque about each
    is that of the force at the end on the box, or at the foot of a leg; who carries another module
    bears its force. Latch moments of arms are left out.
    """
    motion = plan.motion
    count = len(plan.module_names)
    force = np.zeros((len(motion.time), count))
    torque = np.zeros_like(force)
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
            for who, part in _bearers(plan, m, np.arange(len(at)), at):
                now = at[part]
                size = np.linalg.norm(f[part], axis=1)
                force[now, who] = np.maximum(force[now, who], size)
                turned = _torque(plan, who, now, where[part], f[part])
                torque[now, who] = np.maximum(torque[now, who], turned)
    length = sum(plan.module["link_lengths"])
    own = plan.module["mass"] * GRAVITY * length / 2
    return Loads(force, torque, float(own), float(plan.module["max_torque"]))


def _bearers(
    plan: LimmsPlan, module: int, part: IntArray, at: IntArray
) -> Iterator[tuple[int, IntArray]]:
    """A module and those that carry it, with the places in `at` (samples) where they do."""
    yield module, part
    first = len(plan.anchor_names)
    for anchors in (plan.motion.base_anchor[:, module], plan.motion.tip_anchor[:, module]):
        parent = np.where(anchors[at[part]] >= first, (anchors[at[part]] - first) // 2, -1)
        for who in np.unique(parent[parent >= 0]):
            if int(who) != module:
                yield from _bearers(plan, int(who), part[parent == who], at)


def _torque(plan: LimmsPlan, module: int, at: IntArray, where: Array, force: Array) -> Array:
    """Largest torque (n) [N m] at any joint of a module from forces (n, 3) `where` (n, 3)."""
    motion = plan.motion
    most = np.zeros(len(at))
    for joint in range(1, 7):
        axis = motion.joint_rotation[at, module, joint, :, 2 if joint in (1, 4, 6) else 1]
        arm = np.cross(where - motion.joint_position[at, module, joint], force)
        most = np.maximum(most, np.abs((arm * axis).sum(axis=1)))
    return most
