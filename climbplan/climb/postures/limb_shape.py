"""A limb as the convex posture statement knows it: shoulder, toe, and the knee to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene import ClimbScene
from climbplan.robots.kinematics import inverse, joint_points_body
from climbplan.robots.rotations import Array

_KNEE = 2  # among shoulder, femur joint, knee, toe
_STEP = 1e-5  # [m] of the differences


@dataclass(frozen=True)
class Knee:
    """knee = at + by_toe (toe - stance) near the nominal stance, body frame."""

    stance: Array  # (3,) nominal toe [m]
    at: Array  # (3,) knee of the nominal stance [m]
    by_toe: Array  # (3, 3)
    lifted: Array  # (R, 3) how far it moves when the toe is lifted off a region it may use [m]


@dataclass(frozen=True)
class LimbShape:
    """What has to be beyond an obstacle's face, body frame."""

    shoulder: Array  # (3,) [m]
    femur: float  # [m]
    knee: Knee | None  # None where the nominal stance, or the toe lifted off it, is out of reach


def limb_shape(scene: ClimbScene, limb: int, reference: Array) -> LimbShape:
    """A limb about the stance of the scene; reference: (3, 3) rotation of the body there."""
    robot = scene.robot
    regions = [scene.terrain.regions[r] for r in np.flatnonzero(scene.terrain.allowed[limb])]
    normals = np.unique([region.normal for region in regions], axis=0) @ reference
    moved = np.vstack(
        [np.zeros(3), _STEP * np.eye(3), -_STEP * np.eye(3), scene.spec.trajectory.lift * normals]
    )
    toes = np.tile(robot.stance_body, (len(moved), 1, 1))
    toes[:, limb] += moved
    solution = inverse(robot, toes)
    knee = None
    if solution.valid[:, limb].all():
        knees = joint_points_body(robot, np.nan_to_num(solution.best()))[:, limb, _KNEE]
        knee = Knee(
            stance=robot.stance_body[limb],
            at=knees[0],
            by_toe=(knees[1:4] - knees[4:7]).T / (2 * _STEP),
            lifted=knees[7:] - knees[0],
        )
    return LimbShape(robot.shoulder_body[limb], float(robot.link_lengths[limb, 1]), knee)
