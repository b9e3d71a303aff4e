"""A limb as the convex posture statement knows it: shoulder, toe, and the knee to first order.

The knee of a chain is the joint that stands off farthest from the way from its first joint to its
toe; what its other joints meet, the exact check finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.kinematics import inverse, joint_points_body, turns_under
from climbplan.robots.model import Robot

_STEP = 1e-5  # [m] of the differences
_POSTURES = 1000  # sampled of a chain


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
    highest: float  # [m] by which the knee may be above the shoulder at most
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
    # Soles lie level: what they do on slopes, the exact check finds
    turns = turns_under(robot, reference, np.broadcast_to([0.0, 0.0, 1.0], toes.shape))
    solution = inverse(robot, toes, turns)
    points = joint_points_body(robot, np.nan_to_num(solution.best()))[:, limb]
    joint = _knee_of(robot, points[0])
    knee = None
    if solution.valid[:, limb].all():
        knees = points[:, joint]
        knee = Knee(
            stance=robot.stance_body[limb],
            at=knees[0],
            by_toe=(knees[1:4] - knees[4:7]).T / (2 * _STEP),
            lifted=knees[7:] - knees[0],
        )
    return LimbShape(robot.shoulder_body[limb], _highest(robot, limb, joint), knee)


def _knee_of(robot: Robot, points: Array) -> int:
    """The joint of a limb, with joints and toe at points (P, 3), farthest off the straight way."""
    if robot.mechanism is None:
        return 2
    along = points[-1] - points[0]
    off = np.cross(points[1:-1] - points[0], along / np.linalg.norm(along))
    return 1 + int(np.argmax(np.linalg.norm(off, axis=1)))


def _highest(robot: Robot, limb: int, knee: int) -> float:
    """The femur's length, or by how much sampled postures of a chain lift its knee."""
    if robot.mechanism is None:
        return float(robot.link_lengths[limb, 1])
    own = robot.one_limb(limb)
    share = np.random.default_rng(0).random((_POSTURES, 1, robot.joint_count))
    angles = own.joint_lower + share * (own.joint_upper - own.joint_lower)
    points = joint_points_body(own, angles)[:, 0]
    return float(max(0.0, (points[:, knee, 2] - points[:, 0, 2]).max()))
