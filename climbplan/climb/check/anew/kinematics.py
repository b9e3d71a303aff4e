"""Limb kinematics from the definitions of the file format, by rotations about joint axes.

A limb that is no other chain (`chains.py`) has a coxa, a femur and a tibia. The coxa rotates about
the body's z axis at the shoulder, femur and tibia about the horizontal axis through the limb's
plane. At zero angles coxa and femur point outward, the tibia down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import (
    EquilibriumChains,
    build_chains,
    rotate_by_chain,
    solve_chain_equilibrium,
)
from climbplan.climb.check.anew.five_bars import build_five_bars, solve_five_bars
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.foot import Sole
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

_MAX_ITERATIONS = 60
_MAX_STEP = 0.2  # [rad] of a step
_STEP_TOLERANCE = 1e-13  # [rad] of the last step
_REGULARISATION = 1e-14  # give, by which singular limbs have an answer


def solve_sole_equilibrium(
    chain: SerialChain,
    sole: Sole,
    toes: Array,
    axes: Array,
    *,
    initial: Array,
    command: Array,
    spring: Array,
) -> EquilibriumChains:
    """Return angles near `initial` (..., N, J) with soles at given poses, body frame.

    Limbs with more than six joints take the angles of least energy. Newton's method solves k (q -
    command) = J^T w for angles q, and force and moment w.

    Args:
        chain: The chains of all limbs.
        sole: The soles.
        toes: (..., N, 3) positions of the toes [m].
        axes: (..., N, 3, 3) axes of the soles as rows.
        initial: (..., N, J) initial angles [rad].
        command: (..., N, J) commanded angles [rad].
        spring: (N, J) stiffness of the joints [N m/rad].
    """
    rows = np.swapaxes(sole.axes_zero, -1, -2)
    count = initial.shape[-1]
    q, wrench = initial.copy(), np.zeros((*initial.shape[:-1], 6))
    matrix = np.zeros((*initial.shape[:-1], count + 6, count + 6))
    matrix[..., :count, :count] = spring[:, None, :] * np.eye(count)
    matrix[..., count:, count:] = _REGULARISATION * np.eye(6)
    for _ in range(_MAX_ITERATIONS):
        limbs = build_chains(chain, q)
        axis_columns = np.swapaxes(limbs.axes, -1, -2)
        angular_columns = axis_columns if limbs.drive is None else axis_columns @ limbs.drive
        foot_jacobian = np.concatenate([limbs.jacobian(), angular_columns], axis=-2)
        sole_axes = np.stack([rotate_by_chain(chain, q, rows[:, k]) for k in range(3)], axis=-2)
        pose_error = np.concatenate(
            [toes - limbs.toe, np.cross(sole_axes, axes).sum(axis=-2) / 2], axis=-1
        )
        matrix[..., :count, count:] = -np.swapaxes(foot_jacobian, -1, -2)
        matrix[..., count:, :count] = foot_jacobian
        torque_residual = (np.swapaxes(foot_jacobian, -1, -2) @ wrench[..., None])[
            ..., 0
        ] - spring * (q - command)
        right_hand_side = np.concatenate([torque_residual, pose_error], axis=-1)
        step = np.asarray(np.linalg.solve(matrix, right_hand_side[..., None])[..., 0], np.float64)
        max_change = np.abs(step[..., :count]).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _MAX_STEP / np.maximum(max_change, 1e-300))
        q = q + step[..., :count]
        wrench = wrench + step[..., count:]
        if not (max_change > _STEP_TOLERANCE).any():
            break
    limbs = build_chains(chain, q)
    sole_axes = np.stack([rotate_by_chain(chain, q, rows[:, k]) for k in range(3)], axis=-2)
    axis_error = np.linalg.norm(sole_axes - axes, axis=-1).max(
        axis=-1
    )  # one radian counts as one metre
    return EquilibriumChains(q, np.maximum(np.linalg.norm(toes - limbs.toe, axis=-1), axis_error))


_CLOSURE_TOLERANCE = 1e-9  # [m] rounding of legs that reach their toes


def rotate(vector: Array, axis: Array, angle: Array) -> Array:
    """Rotate vectors (..., 3) about unit axes (..., 3) by angles (...) [rad] (Rodrigues)."""
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    axial = (vector * axis).sum(axis=-1, keepdims=True)
    return vector * cos + np.cross(axis, vector) * sin + axis * axial * (1 - cos)


def compute_body_axes(rpy: Array) -> Array:
    """Return the body's x, y, z axes as rows (..., 3, 3), world: Rz(yaw) Ry(pitch) Rx(roll)."""
    axes = np.broadcast_to(np.eye(3), (*rpy.shape[:-1], 3, 3))
    for world_axis, angle in enumerate(np.moveaxis(rpy, -1, 0)):  # about x, then y, then z
        axes = rotate(axes, np.eye(3)[world_axis], angle[..., None])
    return axes


def transform_to_world(com: Array, axes: Array, points: Array) -> Array:
    """Return world positions (..., P, 3) of body points (P, 3) for bodies at com (..., 3)."""
    return com[..., None, :] + points @ axes


@dataclass(frozen=True)
class Limbs:
    """Joint positions and axes of all limbs in the world."""

    joints: Array  # (..., N, J, 3) coxa, femur and tibia joint, or those of a chain [m]
    axes: Array  # (..., N, J, 3) their unit axes, zero of joints that slide
    toe: Array  # (..., N, 3) [m]
    drive: Array | None = None  # (..., N, J, J) speeds about the axes by joint speeds, if not alike
    slides: Array | None = None  # (..., N, J, 3) directions in which joints slide, if some do

    @property
    def points(self) -> Array:
        """Return shoulder, femur joint, knee and toe (..., N, J + 1, 3)."""
        return np.concatenate([self.joints, self.toe[..., None, :]], axis=-2)

    def jacobian(self) -> Array:
        """Return the toe's velocity by joint speed, (..., N, 3, J): column j is axis_j x (toe -
        joint_j).

        For prismatic joints the column is the direction of sliding.
        """
        columns = np.cross(self.axes, self.toe[..., None, :] - self.joints)
        if self.slides is not None:
            columns = columns + self.slides
        joint_columns = np.swapaxes(columns, -1, -2)
        return joint_columns if self.drive is None else joint_columns @ self.drive

    def compute_angular_jacobian(self) -> Array:
        """Return the angular velocity of the last link by joint speed as rows (..., N, J, 3)."""
        if self.drive is None:
            return self.axes
        return np.asarray(np.swapaxes(self.drive, -1, -2) @ self.axes)

    def compute_link_frame(self) -> Array:
        """Return the axes of the last link as rows (..., N, 3, 3).

        x is along the link, z along the last joint's axis, and y = z x x.
        """
        z = self.axes[..., -1, :]
        if self.slides is not None:
            z = z + self.slides[..., -1, :]
        link_vector = self.toe - self.joints[..., -1, :]
        link_vector = link_vector - (link_vector * z).sum(axis=-1, keepdims=True) * z
        x = link_vector / np.maximum(_length(link_vector), 1e-12)
        return np.stack([x, np.cross(z, x), z], axis=-2)


def build_limbs(robot: Robot, com: Array, axes: Array, angles: Array) -> Limbs:
    """Return limbs of bodies at com (..., 3), with axes (..., 3, 3), angles (..., N, J) [rad]."""
    if isinstance(robot.mechanism, FiveBar):
        return _build_five_bar_limbs(robot.mechanism, com, axes, angles)
    if robot.mechanism is not None:
        return _build_chain_limbs(require_chain(robot), com, axes, angles)
    shoulder = transform_to_world(com, axes, robot.shoulder_body)
    up = np.broadcast_to(axes[..., 2:3, :], shoulder.shape)
    forward = np.broadcast_to(axes[..., 0:1, :], shoulder.shape)
    outward = rotate(forward, up, robot.mount_yaw + angles[..., 0])
    hinge = np.cross(outward, up)
    femur = rotate(outward, hinge, angles[..., 1])
    tibia = rotate(-up, hinge, angles[..., 1] + angles[..., 2])
    coxa_length, femur_length, tibia_length = (robot.link_lengths[:, j, None] for j in range(3))
    hip = shoulder + coxa_length * outward
    knee = hip + femur_length * femur
    return Limbs(
        joints=np.stack([shoulder, hip, knee], axis=-2),
        axes=np.stack([up, hinge, hinge], axis=-2),
        toe=knee + tibia_length * tibia,
    )


@dataclass(frozen=True)
class HeldLimbs:
    """Limbs whose toes are held by the terrain while the body moves."""

    points: Array  # (..., N, J + 1, 3) shoulder, femur joint, knee, toe [m]
    angles: Array  # (..., N, J) [rad]
    missing: Array  # (..., N) distance by which the links do not reach the toe [m]


def solve_standing_limbs(
    robot: Robot,
    com: Array,
    axes: Array,
    toes: Array,
    *,
    initial: Array,
    command: Array,
    arm: Array | None = None,
    soles: Array | None = None,
) -> HeldLimbs:
    """Return limbs that reach toes (..., N, 3), with knees on the side of the initial angles.

    Angles are those within half a turn of the initial ones. The knee is an intersection of the
    circles of femur and tibia in the limb's plane. A chain of more than three joints takes the
    equilibrium of its springs.

    Args:
        robot: The robot.
        com: (..., 3) body origins [m].
        axes: (..., 3, 3) body axes as rows.
        toes: (..., N, 3) positions of the toes, world [m].
        initial: (..., N, J) joint angles [rad].
        command: (..., N, J) commanded joint angles [rad].
        arm: (..., N, 3) from toes to where forces act on feet of finite size [m]; None for the
            toes.
        soles: (..., N, 3, 3) axes of flat feet as rows; None for other feet.
    """
    if soles is not None:
        return _solve_standing_soles(
            robot, com, axes, toes, soles, initial=initial, command=command
        )
    if isinstance(robot.mechanism, FiveBar):
        return _solve_standing_five_bars(robot.mechanism, com, axes, toes, initial)
    if robot.mechanism is not None:
        return _solve_standing_chains(
            robot, com, axes, toes, initial=initial, command=command, arm=arm
        )
    return _solve_standing_legs(robot, com, axes, toes, initial)


def _solve_standing_legs(
    robot: Robot, com: Array, axes: Array, toes: Array, initial: Array
) -> HeldLimbs:
    """Return limbs of coxa, femur and tibia that reach toes (..., N, 3)."""
    model = build_limbs(robot, com, axes, initial)
    shoulder = transform_to_world(com, axes, robot.shoulder_body)
    up = axes[..., 2:3, :]
    reach = toes - shoulder
    level_reach = reach - _dot(reach, up) * up
    outward = level_reach / np.maximum(_length(level_reach), 1e-12)
    model_out = model.joints[..., 1, :] - model.joints[..., 0, :]
    outward = outward * np.where(_dot(outward, model_out) < 0, -1.0, 1.0)
    hinge = np.cross(outward, np.broadcast_to(up, outward.shape))

    coxa, femur, tibia = (robot.link_lengths[:, j, None] for j in range(3))
    hip = shoulder + coxa * outward
    span = toes - hip
    distance = np.maximum(_length(span), 1e-12)
    missing = np.maximum(distance - femur - tibia, np.abs(femur - tibia) - distance)
    toward = span / distance
    femur_projection = (femur**2 - tibia**2 + distance**2) / (2 * distance)
    knee_offset = np.sqrt(np.maximum(femur**2 - femur_projection**2, 0.0))
    side = np.cross(hinge, toward)
    bend_normal = np.cross(
        model.toe - model.joints[..., 1, :],
        model.joints[..., 2, :] - model.joints[..., 1, :],
    )
    sign = np.where(_dot(bend_normal, model.axes[..., 1, :]) < 0, -1.0, 1.0)
    knee = hip + femur_projection * toward + sign * knee_offset * side

    thigh, shin = knee - hip, toes - knee
    forward = np.broadcast_to(axes[..., 0:1, :], outward.shape)
    sideward = np.broadcast_to(axes[..., 1:2, :], outward.shape)
    heading = np.arctan2(_dot(outward, sideward), _dot(outward, forward))[..., 0]
    femur_angle = np.arctan2(_dot(thigh, up), _dot(thigh, outward))[..., 0]
    shin_angle = np.arctan2(_dot(shin, outward), -_dot(shin, up))[..., 0]
    angles = np.stack([heading - robot.mount_yaw, femur_angle, shin_angle - femur_angle], axis=-1)
    angles = angles - 2 * np.pi * np.round((angles - initial) / (2 * np.pi))
    return HeldLimbs(
        points=np.stack([shoulder, hip, knee, toes], axis=-2),
        angles=angles,
        missing=np.maximum(missing[..., 0], 0.0),
    )


def require_chain(robot: Robot) -> SerialChain:
    """Return the chains of a robot; raise TypeError for a mechanism that no check models."""
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError(f"no check knows limbs of type {type(robot.mechanism).__name__}")
    return robot.mechanism


def _build_five_bar_limbs(legs: FiveBar, com: Array, axes: Array, angles: Array) -> Limbs:
    """Return five-bar legs of bodies at com (..., 3) with axes (..., 3, 3), in the world."""
    body = build_five_bars(legs, angles)
    turn, origin = axes[..., None, :, :], com[..., None, :]
    return Limbs(
        joints=origin[..., None, :] + body.joints @ turn,
        axes=body.axes @ turn,
        toe=origin + (body.toe[..., None, :] @ turn)[..., 0, :],
        drive=body.drive,
    )


def _solve_standing_five_bars(
    legs: FiveBar, com: Array, axes: Array, toes: Array, initial: Array
) -> HeldLimbs:
    """Return five-bar legs that reach toes (..., N, 3)."""
    local = np.einsum("...ij,...nj->...ni", axes, toes - com[..., None, :])
    angles = solve_five_bars(legs, local, initial)
    limbs = _build_five_bar_limbs(legs, com, axes, angles)
    missing = np.linalg.norm(limbs.toe - toes, axis=-1)
    return HeldLimbs(limbs.points, angles, np.where(missing > _CLOSURE_TOLERANCE, missing, 0.0))


def _build_chain_limbs(chain: SerialChain, com: Array, axes: Array, angles: Array) -> Limbs:
    """Return chains of bodies at com (..., 3) with axes (..., 3, 3), in the world."""
    body = build_chains(chain, angles)
    turn, origin = axes[..., None, :, :], com[..., None, :]
    return Limbs(
        joints=origin[..., None, :] + body.joints @ turn,
        axes=body.axes @ turn,
        toe=origin + (body.toe[..., None, :] @ turn)[..., 0, :],
        drive=body.drive,
        slides=body.slides @ turn,
    )


def _solve_standing_chains(
    robot: Robot,
    com: Array,
    axes: Array,
    toes: Array,
    *,
    initial: Array,
    command: Array,
    arm: Array | None,
) -> HeldLimbs:
    """Return chains that reach toes (..., N, 3), with joints as springs about their commands."""
    chain = require_chain(robot)
    local = np.einsum("...ij,...nj->...ni", axes, toes - com[..., None, :])
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    if arm is not None:
        arm = np.einsum("...ij,...nj->...ni", axes, arm)
    equilibrium = solve_chain_equilibrium(chain, local, initial, command, spring, arm)
    points = _build_chain_limbs(chain, com, axes, equilibrium.angles).points
    return HeldLimbs(points, equilibrium.angles, equilibrium.missing)


def _solve_standing_soles(
    robot: Robot,
    com: Array,
    axes: Array,
    toes: Array,
    soles: Array,
    *,
    initial: Array,
    command: Array,
) -> HeldLimbs:
    """Return chains whose soles are at the toes, with joints as springs about their commands."""
    chain, sole = require_chain(robot), robot.sole
    assert sole is not None
    local = np.einsum("...ij,...nj->...ni", axes, toes - com[..., None, :])
    sole_axes = soles @ np.swapaxes(axes, -1, -2)[..., None, :, :]
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    equilibrium = solve_sole_equilibrium(
        chain, sole, local, sole_axes, initial=initial, command=command, spring=spring
    )
    points = _build_chain_limbs(chain, com, axes, equilibrium.angles).points
    return HeldLimbs(points, equilibrium.angles, equilibrium.missing)


def _dot(a: Array, b: Array) -> Array:
    """Return dot products (..., 1) of vectors."""
    return (a * b).sum(axis=-1, keepdims=True)


def _length(a: Array) -> Array:
    """Return lengths (..., 1) of vectors."""
    return np.sqrt(_dot(a, a))
