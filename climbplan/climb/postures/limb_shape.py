"""A limb in the convex posture statement: shoulder, toe, and the knee to first order.

The knee of a chain is the joint farthest from the straight line between its first joint and its
toe. Collisions of its other joints are found by the exact check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.kinematics import joint_points_body, solve_inverse_kinematics, turns_under
from climbplan.robots.model import Robot

_DIFFERENCE_STEP = 1e-5  # [m] of the differences
_NUM_SAMPLES = 1000  # sampled of a chain


@dataclass(frozen=True)
class Knee:
    """First-order model near the nominal stance: knee = position + toe_jacobian (toe - stance),
    body frame.
    """

    stance: Array  # (3,) nominal toe [m]
    position: Array  # (3,) knee of the nominal stance [m]
    toe_jacobian: Array  # (3, 3)
    lift_offsets: (
        Array  # (R, 3) how far it moves when the toe is lifted off a region it may use [m]
    )


@dataclass(frozen=True)
class LimbKeyPoints:
    """The points of a limb that have to be beyond an obstacle's face, body frame."""

    shoulder: Array  # (3,) [m]
    max_knee_height: float  # [m] by which the knee may be above the shoulder at most
    knee: Knee | None  # None where the nominal stance, or the toe lifted off it, is out of reach


def linearise_limb(scene: ClimbScene, limb: int, reference: Array) -> LimbKeyPoints:
    """Linearise the kinematics of a limb about the nominal stance of the robot.

    Args:
        scene: The climb.
        limb: Index of the limb.
        reference: (3, 3) rotation of the body at which the limb is linearised.
    """
    robot = scene.robot
    regions = [scene.terrain.regions[r] for r in np.flatnonzero(scene.terrain.allowed[limb])]
    normals = np.unique([region.normal for region in regions], axis=0) @ reference
    toe_offsets = np.vstack(
        [
            np.zeros(3),
            _DIFFERENCE_STEP * np.eye(3),
            -_DIFFERENCE_STEP * np.eye(3),
            scene.spec.trajectory.swing_clearance * normals,
        ]
    )
    toes = np.tile(robot.stance_body, (len(toe_offsets), 1, 1))
    toes[:, limb] += toe_offsets
    # Soles lie level: what they do on slopes, the exact check finds
    sole_rotations = turns_under(robot, reference, np.broadcast_to([0.0, 0.0, 1.0], toes.shape))
    solution = solve_inverse_kinematics(robot, toes, sole_rotations)
    points = joint_points_body(robot, np.nan_to_num(solution.best()))[:, limb]
    knee_joint = _find_knee_joint(robot, points[0])
    knee = None
    if solution.valid[:, limb].all():
        knees = points[:, knee_joint]
        knee = Knee(
            stance=robot.stance_body[limb],
            position=knees[0],
            toe_jacobian=(knees[1:4] - knees[4:7]).T / (2 * _DIFFERENCE_STEP),
            lift_offsets=knees[7:] - knees[0],
        )
    return LimbKeyPoints(
        robot.shoulder_body[limb], _bound_knee_height(robot, limb, knee_joint), knee
    )


def _find_knee_joint(robot: Robot, points: Array) -> int:
    """Return the joint farthest from the line between first joint and toe, for points (P, 3)."""
    if robot.mechanism is None:
        return 2
    chord = points[-1] - points[0]
    offsets = np.cross(points[1:-1] - points[0], chord / np.linalg.norm(chord))
    return 1 + int(np.argmax(np.linalg.norm(offsets, axis=1)))


def _bound_knee_height(robot: Robot, limb: int, knee: int) -> float:
    """Return the femur's length, or how far sampled postures of a chain lift its knee [m]."""
    if robot.mechanism is None:
        return float(robot.link_lengths[limb, 1])
    one_limb = robot.one_limb(limb)
    fractions = np.random.default_rng(0).random((_NUM_SAMPLES, 1, robot.joint_count))
    angles = one_limb.joint_lower + fractions * (one_limb.joint_upper - one_limb.joint_lower)
    points = joint_points_body(one_limb, angles)[:, 0]
    return float(max(0.0, (points[:, knee, 2] - points[:, 0, 2]).max()))
