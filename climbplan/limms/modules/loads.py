"""Joint torques of modules from the forces on the box, and from their own weight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY


@dataclass(frozen=True)
class Loads:
    """Loads over a plan (T samples, L modules), with the values to compare them with."""

    force: Array  # (T, L) [N] that each module passes on
    torque: Array  # (T, L) [N m] at its worst joint, from that force alone
    own_weight: float  # [N m] at a joint that holds a whole straight module horizontally
    limit: float  # [N m]


def compute_loads(plan: LimmsPlan) -> Loads:
    """Compute the loads of all modules.

    A module without mass transmits one force through all of its joints. The torque about each joint
    is that of the force at the end on the box, or at the foot of a leg. A module that carries
    another one bears its force. Latch moments of arms are neglected.
    """
    motion = plan.motion
    count = len(plan.module_names)
    force = np.zeros((len(motion.time), count))
    torque = np.zeros_like(force)
    for m in range(count):
        for end, anchors in enumerate((motion.base_anchor[:, m], motion.tip_anchor[:, m])):
            samples = np.flatnonzero((anchors >= 0) & (anchors < 4 * len(plan.box_size)))
            if not len(samples):
                continue
            box, side = anchors[samples] // 4, anchors[samples] % 4
            box_force = motion.force[samples, box, side]
            is_leg = motion.mode[samples, m] == 4
            points = motion.joint_position[samples, m]
            point = np.where(is_leg[:, None], points[:, 7 * (1 - end)], points[:, 7 * end])
            for bearer, indices in _iterate_bearers(plan, m, np.arange(len(samples)), samples):
                bearer_samples = samples[indices]
                magnitude = np.linalg.norm(box_force[indices], axis=1)
                force[bearer_samples, bearer] = np.maximum(force[bearer_samples, bearer], magnitude)
                moment = _compute_max_torque(
                    plan, bearer, bearer_samples, point[indices], box_force[indices]
                )
                torque[bearer_samples, bearer] = np.maximum(torque[bearer_samples, bearer], moment)
    length = sum(plan.module["link_lengths"])
    own_moment = plan.module["mass"] * GRAVITY * length / 2
    return Loads(force, torque, float(own_moment), float(plan.module["max_torque"]))


def _iterate_bearers(
    plan: LimmsPlan, module: int, indices: IntArray, samples: IntArray
) -> Iterator[tuple[int, IntArray]]:
    """Yield a module and those that carry it, with the indices into `samples` where they do."""
    yield module, indices
    first = len(plan.anchor_names)
    for anchors in (plan.motion.base_anchor[:, module], plan.motion.tip_anchor[:, module]):
        parent = np.where(
            anchors[samples[indices]] >= first, (anchors[samples[indices]] - first) // 2, -1
        )
        for bearer in np.unique(parent[parent >= 0]):
            if int(bearer) != module:
                yield from _iterate_bearers(plan, int(bearer), indices[parent == bearer], samples)


def _compute_max_torque(
    plan: LimmsPlan, module: int, samples: IntArray, points: Array, force: Array
) -> Array:
    """Return the largest torque (n,) at any joint of a module from forces (n, 3) [N m]."""
    motion = plan.motion
    max_torque = np.zeros(len(samples))
    for joint in range(1, 7):
        axis = motion.joint_rotation[samples, module, joint, :, 2 if joint in (1, 4, 6) else 1]
        moment = np.cross(points - motion.joint_position[samples, module, joint], force)
        max_torque = np.maximum(max_torque, np.abs((moment * axis).sum(axis=1)))
    return max_torque
