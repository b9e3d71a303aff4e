"""Collisions between grippers on neighbouring holds, in planning.

A gripper is modelled as a T of capsules with the limb's radius: from the wrist to the palm, and
from one open finger to the other. `climbplan/climb/check/grips.py` measures it independently.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.self_clearance import compute_segment_distances

_MIN_OVERLAP = 1e-9  # [m] that counts


@dataclass(frozen=True)
class GripCollision:
    """Two grippers that overlap."""

    limb: int
    other_limb: int
    overlap: float  # [m]
    description: str


def find_grip_collision(scene: ClimbScene, instants: Instants) -> GripCollision | None:
    """Return the two grippers that overlap most at the instants; None without an overlap."""
    robot = scene.robot
    if robot.gripper is None or scene.grippers is None:
        return None
    standoff = np.array([getattr(s, "standoff", 0.0) for s in scene.terrain.surfaces])
    region = instants.region
    palm = instants.toes - standoff[region][..., None] * instants.normal
    half_span = robot.gripper.finger_span / 2 * scene.grippers.axis[region]
    bars = ((instants.toes, palm), (palm - half_span, palm + half_span))  # each (K, N, 3)
    is_standing = np.asarray(instants.contact, bool)
    worst: GripCollision | None = None
    for i, j in itertools.combinations(range(robot.limb_count), 2):
        distance = np.min(
            [
                compute_segment_distances(p[:, i], q[:, i], r[:, j], s[:, j])
                for (p, q), (r, s) in itertools.product(bars, bars)
            ],
            axis=0,
        )
        overlap: Array = np.where(
            is_standing[:, i] & is_standing[:, j], 2 * robot.limb_radius - distance, 0.0
        )
        k = int(np.argmax(overlap))
        if overlap[k] > max(_MIN_OVERLAP, worst.overlap if worst is not None else 0.0):
            first_name, second_name = robot.limb_names[i], robot.limb_names[j]
            description = (
                f"{instants.label(k, robot.limb_names)}, {first_name}'s gripper would be "
                f"{1e3 * overlap[k]:.1f} mm deep in {second_name}'s"
            )
            worst = GripCollision(i, j, float(overlap[k]), description)
    return worst
