"""Room between grippers that hold on beside each other, in planning.

A gripper is a T: from the wrist to the palm, and from one open finger to the other, as thick as a
limb. `climbplan/climb/check/grips.py` measures it again.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.touching_parts import segment_distances

_OVERLAP = 1e-9  # [m] that counts


@dataclass(frozen=True)
class GripsMeet:
    """Two grippers that would be in each other's place."""

    limb: int
    other: int
    missing: float  # [m]
    words: str


def grips_meet(scene: ClimbScene, instants: Instants) -> GripsMeet | None:
    """The two grippers that overlap most at the instants; None for none."""
    robot = scene.robot
    if robot.gripper is None or scene.grippers is None:
        return None
    standoff = np.array([getattr(s, "standoff", 0.0) for s in scene.terrain.surfaces])
    region = instants.region
    palm = instants.toes - standoff[region][..., None] * instants.normal
    half = robot.gripper.finger_span / 2 * scene.grippers.axis[region]
    bars = ((instants.toes, palm), (palm - half, palm + half))  # each (K, N, 3)
    stands = np.asarray(instants.contact, bool)
    worst: GripsMeet | None = None
    for i, j in itertools.combinations(range(robot.limb_count), 2):
        apart = np.min(
            [
                segment_distances(p[:, i], q[:, i], r[:, j], s[:, j])
                for (p, q), (r, s) in itertools.product(bars, bars)
            ],
            axis=0,
        )
        missing: Array = np.where(stands[:, i] & stands[:, j], 2 * robot.limb_radius - apart, 0.0)
        k = int(np.argmax(missing))
        if missing[k] > max(_OVERLAP, worst.missing if worst is not None else 0.0):
            one, two = robot.limb_names[i], robot.limb_names[j]
            words = (
                f"{instants.label(k, robot.limb_names)}, {one}'s gripper would be "
                f"{1e3 * missing[k]:.1f} mm deep in {two}'s"
            )
            worst = GripsMeet(i, j, float(missing[k]), words)
    return worst
