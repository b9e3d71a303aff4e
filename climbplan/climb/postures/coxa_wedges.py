"""Bounds of the first joints (coxae) as halfspaces of toes in the convex statement.

A coxa rotates about the body's z axis. Where its bounds are less than 180 degrees apart, a limb
that faces its toe has it in the wedge between two planes through the shoulder,

    n . (R' (p - com) - shoulder) >= 0,

which is linear in toe and body at a given rotation. To first order the body rotates by t = rates
(Theta - Theta0) in its own frame, so that R' (p - com) = v - t x v with v = R0' (p - com). In this
product alone v is taken at the nominal stance:

    (R0 n) . (p - com) - (stance x n) . t >= n . shoulder.

Balls about nominal stances imply these rows where they lie within the wedge. So only planes that
cut a ball are added.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.program import Program
from climbplan.robots.coxa_femur_tibia import CoxaFemurTibia
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body
from climbplan.robots.model import Robot

_MAX_WEDGE_ANGLE = np.deg2rad(175.0)  # between bounds: beyond it they are no wedge
_MIN_WEDGE_FRACTION = 0.1  # share of a wedge that margins leave at least
_START_SLACK = 1e-7  # [m] by which toes that are given may be past a plane, for rounding

Entries = Any  # an AffineArray, which NumPy's signatures do not know


def has_vertical_coxa(robot: Robot) -> bool:
    """Return whether the first joints of limbs are known to rotate about the body's z axis."""
    return isinstance(robot.limbs, CoxaFemurTibia)


def compute_wedge_normals(robot: Robot, limb: int, joint_margin: float = 0.0) -> Array:
    """Return unit normals n (2, 3), body frame, of the planes that a toe is on the inner side of.

    Args:
        robot: The robot.
        limb: Index of the limb.
        joint_margin: Distance of the joint from its bounds [rad].

    Returns:
        An array (0, 3) for bounds that make no wedge, and for robots whose first joints are not
            known
        to rotate about the body's z axis.
    """
    width = float(robot.joint_upper[limb, 0] - robot.joint_lower[limb, 0])
    if not has_vertical_coxa(robot) or width > _MAX_WEDGE_ANGLE:
        return np.zeros((0, 3))
    margin = min(joint_margin, (1.0 - _MIN_WEDGE_FRACTION) * width / 2)
    low = robot.mount_yaw[limb] + robot.joint_lower[limb, 0] + margin
    high = robot.mount_yaw[limb] + robot.joint_upper[limb, 0] - margin
    return np.array([[-np.sin(low), np.cos(low), 0.0], [np.sin(high), -np.cos(high), 0.0]])


def compute_coxa_margins(robot: Robot, com: Array, rpy: Array, toes: Array) -> Array:
    """Return how far (N,) first joints are within their bounds in a posture [rad], 0 out of reach.

    The result is zero for robots whose first joints make no wedges.
    """
    if not has_vertical_coxa(robot):
        return np.zeros(robot.limb_count)
    angle = solve_inverse_kinematics(robot, to_body(com, rpy, toes)).best()[:, 0]
    margin = np.minimum(angle - robot.joint_lower[:, 0], robot.joint_upper[:, 0] - angle)
    return np.asarray(np.maximum(np.nan_to_num(margin), 0.0))


def _linearise_distance(
    normal: Array,
    moment_arm: Array,
    toe: Entries,
    pose: tuple[Entries, Entries],
    frame: tuple[Array, Array, Array],
) -> Entries:
    """Return distances (M, S) of toes (M, 3) along body normals (M, S, 3), linear in the pose.

    moment_arm: (M, S, 3) stance x normal; pose and frame as in `add_coxa_wedges`.
    """
    (com, rpy), (reference, rates, level) = pose, frame
    normal_component = (toe - com)[:, None].along((normal @ reference.T)[..., None])
    rotation_component = (rpy - level)[:, None].along((moment_arm @ rates)[..., None])
    return (normal_component - rotation_component)[..., 0]


def add_coxa_wedges(
    p: Program,
    robot: Robot,
    radius: Array,
    joint_margin: Array | None,
    *,
    start: tuple[Array, Array, Array],
    frame: tuple[Array, Array, Array],
    postures: tuple[Entries, Entries, Entries],
    moving: tuple[Entries, Entries],
) -> None:
    """Keep toes within the wedges of their coxae at ends of rounds, at lifts and at placings.

    One block is added for each limb whose ball of `radius` a plane cuts.

    Args:
        p: The posture program.
        robot: The robot.
        radius: (N,) radii of the balls about nominal stances [m].
        joint_margin: (N,) distances of joints from their bounds [rad]; None for no margin.
        start: Body origin (3,), angles (3,) and toes (N, 3) of the start. On its toes joints keep
            no larger margin than they have there.
        frame: R0, rates and Theta0 of the linearised rotation.
        postures: Toes (M + 1, N, 3), body origins and angles (M + 1, 3).
        moving: Body origins and angles (M, N, 3) at the time when each limb moves.
    """
    toes, coms, turns = postures
    m = toes.shape[0] - 1
    stance_offset = robot.stance_body - robot.shoulder_body
    start_margin = compute_coxa_margins(robot, *start)
    for limb, name in enumerate(robot.limb_names):
        margin = 0.0 if joint_margin is None else float(joint_margin[limb])
        normals = compute_wedge_normals(robot, limb, margin)
        cuts_ball = normals @ stance_offset[limb] < radius[limb]
        if not cuts_ball.any():
            continue
        round_normals = np.tile(normals[cuts_ball], (m, 1, 1))
        first_round_normals = round_normals.copy()
        # Where the start's toes stand no tightening changes
        first_round_normals[0] = compute_wedge_normals(
            robot, limb, min(margin, float(start_margin[limb]))
        )[cuts_ball]
        slack = np.zeros((m, 1))
        slack[0] = _START_SLACK
        poses_at_move = moving[0][:, limb], moving[1][:, limb]
        wedge_distances, min_distances = [], []
        for normal, toe, pose, slack_of_event in (
            (round_normals, toes[1:, limb], (coms[1:], turns[1:]), 0.0),
            (round_normals, toes[1:, limb], poses_at_move, 0.0),
            (first_round_normals, toes[:-1, limb], poses_at_move, slack),
        ):
            moment_arm = np.cross(robot.stance_body[limb], normal)
            wedge_distances.append(_linearise_distance(normal, moment_arm, toe, pose, frame))
            min_distances.append(normal @ robot.shoulder_body[limb] - slack_of_event)
        p.between(
            f"workspace.turn_{name}",
            np.concatenate(wedge_distances, axis=1),
            np.concatenate(min_distances, axis=1),
            np.inf,
            unit="m",
        )
