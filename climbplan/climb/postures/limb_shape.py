"""A limb as the convex posture statement knows it: shoulder, toe, and knees to first order.

A knee is any joint between the first and the toe that stands off both: the one knee of coxa, femur
and tibia (the femur joint stays near the shoulder), several on a chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene import ClimbScene
from climbplan.robots.kinematics import inverse, joint_points_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array, rotation_world_body

_STEP = 1e-5  # [m] of the differences
_APART = 0.08  # [m] from the first joint, within which a joint counts as being there
_SAME = 1e-3  # [m] between joints that are one knee


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
    highest: float  # [m] by which a knee may be above the shoulder at most, femur or more
    knees: tuple[Knee, ...]  # none where the nominal stance, or the toe lifted, is out of reach


def limb_shape(scene: ClimbScene, limb: int) -> LimbShape:
    """A limb about the stance of the scene."""
    robot = scene.robot
    regions = [scene.terrain.regions[r] for r in np.flatnonzero(scene.terrain.allowed[limb])]
    level = rotation_world_body(np.array([0.0, 0.0, scene.start.rpy[2]]))
    normals = np.unique([region.normal for region in regions], axis=0) @ level
    moved = np.vstack(
        [np.zeros(3), _STEP * np.eye(3), -_STEP * np.eye(3), scene.spec.trajectory.lift * normals]
    )
    toes = np.tile(robot.stance_body, (len(moved), 1, 1))
    toes[:, limb] += moved
    solution = inverse(robot, toes)
    knees: tuple[Knee, ...] = ()
    if solution.valid[:, limb].all():
        points = joint_points_body(robot, np.nan_to_num(solution.best()))[:, limb]
        knees = tuple(
            Knee(
                stance=robot.stance_body[limb],
                at=points[0, j],
                by_toe=(points[1:4, j] - points[4:7, j]).T / (2 * _STEP),
                lifted=points[7:, j] - points[0, j],
            )
            for j in _knees_of(robot, points[0])
        )
    return LimbShape(robot.shoulder_body[limb], _highest(robot, limb), knees)


def _knees_of(robot: Robot, points: Array) -> list[int]:
    """Which joints of a limb with joints and toe at points (P, 3) are knees."""
    if robot.mechanism is None:
        return [2]
    out: list[int] = []
    for j in range(1, len(points) - 1):
        others = [points[k] for k in (*out, len(points) - 1)]
        near = any(np.linalg.norm(points[j] - other) < _SAME for other in others)
        if np.linalg.norm(points[j] - points[0]) >= _APART and not near:
            out.append(j)
    return out


def _highest(robot: Robot, limb: int) -> float:
    """Links between first and last joint, upright: the femur alone, as the coxa is level."""
    if robot.mechanism is None:
        return float(robot.link_lengths[limb, 1])
    return float(robot.link_lengths[limb, :-1].sum())
