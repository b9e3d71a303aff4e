"""Static equilibrium of bodies whose joints are springs about commands, with toes held in place.

Limbs reach from the moved body to their toes. Joints push with tau = k (1 - structural share)
(theta - command), and contact forces are J^-T tau. Forces and moments balance the load. This
nonlinear system is solved by Newton's method from a given pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.chains import build_chains
from climbplan.climb.check.anew.kinematics import (
    Limbs,
    build_limbs,
    require_chain,
    rotate,
    solve_standing_limbs,
)
from climbplan.robots.model import Robot

_DIFFERENCE_STEP = 1e-6  # [m, rad] of the difference quotients
_MAX_STEP = 0.05  # [m, rad] of a Newton step
_MAX_ITERATIONS = 40
_BALANCE_TOLERANCE = 1e-7  # of the load [N, N m]
_MAX_CONDITION = 1e14  # condition number of what has no inverse
_MIN_STIFFNESS_RATIO = (
    1e-8  # part of the largest stiffness; less is left to the load by contacts in a line
)


@dataclass(frozen=True)
class BracedRobot:
    """Robots held by K sets of toes."""

    robot: Robot
    toes: Array  # (K, N, 3) that the terrain holds: where feet of finite size touch [m]
    contact: BoolArray  # (K, N)
    command: Array  # (K, N, J) [rad]
    reference_angles: Array  # (K, N, J) joint angles that tell which way the limbs bend [rad]
    load: Array  # (K, 6) force and moment on the body, weight included
    moment: Array | None = None  # (K, N, 3) that wrists bring, at the toes [N m]
    soles: Array | None = None  # (K, N, 3, 3) rows of soles that the terrain holds, of flat feet


@dataclass(frozen=True)
class JointResponse:
    """Torques, contact forces and residual wrench at given body poses."""

    torque: Array  # (K, N, J) [N m]
    force: Array  # (K, N, 3) on the toes, zero without contact [N]
    moment: Array  # (K, N, 3) on soles, about the toes, else zero [N m]
    wrench: Array  # (K, 6) of forces and load [N, N m]
    limbs: Limbs
    angles: Array  # (K, N, J) [rad]


@dataclass(frozen=True)
class StaticEquilibrium:
    """The equilibrium pose, its forces and its stability."""

    shift: Array  # (K, 3) of the body from where it started [m], NaN if there is none
    turn: Array  # (K, 3) rotation vector likewise [rad]
    torque: Array  # (K, N, J) [N m]
    force: Array  # (K, N, 3) [N]
    moment: Array  # (K, N, 3) on soles, about the toes [N m]
    stiffness_ratio: (
        Array  # (K,) least share of the joints' stiffness left under load; < 0: buckles
    )


def compute_response(braced: BracedRobot, com: Array, axes: Array) -> JointResponse:
    """Return torques and forces for bodies at com (K, 3) with axes (K, 3, 3)."""
    robot = braced.robot
    angles = solve_standing_limbs(
        robot,
        com,
        axes,
        braced.toes,
        initial=braced.reference_angles,
        command=braced.command,
        soles=braced.soles,
    ).angles
    limbs = build_limbs(robot, com, axes, angles)
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    torque = spring * (angles - braced.command) * braced.contact[..., None]
    force_torque = torque
    if braced.moment is not None:  # part of what the joints hold
        force_torque = (
            torque - (limbs.compute_angular_jacobian() @ braced.moment[..., None])[..., 0]
        )
    foot_jacobian = build_foot_jacobian(limbs, braced.soles is not None)
    foot_wrench = np.where(
        braced.contact[..., None], solve_contact_force(foot_jacobian, force_torque), 0.0
    )
    force, sole_moment = foot_wrench[..., :3], foot_wrench[..., 3:]
    moment = np.cross(braced.toes - com[..., None, :], force).sum(axis=-2)
    if braced.soles is None:
        sole_moment = np.zeros_like(force)
    else:
        moment = moment + sole_moment.sum(axis=-2)
    if braced.moment is not None:
        moment = moment + braced.moment.sum(axis=-2)
    wrench = np.concatenate([force.sum(axis=-2), moment], axis=-1) + braced.load
    return JointResponse(torque, force, sole_moment, wrench, limbs, angles)


def build_foot_jacobian(limbs: Limbs, is_flat: bool) -> Array:
    """Return the Jacobian (..., N, R, J) of held toes (R = 3) or held soles (R = 6)."""
    if not is_flat:
        return limbs.jacobian()
    angular_rows = np.swapaxes(limbs.compute_angular_jacobian(), -1, -2)
    return np.concatenate([limbs.jacobian(), angular_rows], axis=-2)


def build_foot_motion(arms: Array, is_flat: bool) -> Array:
    """Return the motion (..., R, 6) of feet at arms (..., 3) from the body's origin, by the body's
    motion.
    """
    motion = build_body_motion(arms)
    if not is_flat:
        return motion
    angular_rows = np.broadcast_to(np.eye(3, 6, 3), motion.shape)
    return np.concatenate([motion, angular_rows], axis=-2)


def solve_contact_force(jacobian: Array, torque: Array) -> Array:
    """Return J^-T tau (..., R), not finite where J is singular; least squares for redundant limbs.

    jacobian: (..., R, J). Redundant limbs in equilibrium have torques J^T f, so that the residual
    is zero.
    """
    if jacobian.shape[-2] != 3:
        gram = jacobian @ np.swapaxes(jacobian, -1, -2)
        return np.asarray((_invert(gram) @ (jacobian @ torque[..., None]))[..., 0])
    if jacobian.shape[-1] != 3:
        gram = jacobian @ np.swapaxes(jacobian, -1, -2)
        torque = (jacobian @ torque[..., None])[..., 0]
        return np.asarray((_invert_transposed(gram) @ torque[..., None])[..., 0])
    return np.asarray((_invert_transposed(jacobian) @ torque[..., None])[..., 0])


def solve_joint_motion(jacobian: Array, motion: Array, spring: Array) -> Array:
    """Return J^-1 B (..., J, 6): joint motions that follow foot motions B, not finite where J is
    singular.

    Redundant limbs move with the least energy of their springs (N, J).
    """
    if jacobian.shape[-2] != 3:
        compliant_columns = np.swapaxes(jacobian, -1, -2) / spring[..., None]
        return np.asarray(compliant_columns @ _invert(jacobian @ compliant_columns) @ motion)
    if jacobian.shape[-1] != 3:
        compliant_columns = np.swapaxes(jacobian, -1, -2) / spring[..., None]
        return np.asarray(
            compliant_columns @ _invert_transposed(jacobian @ compliant_columns) @ motion
        )
    return np.asarray(np.swapaxes(_invert_transposed(jacobian), -1, -2) @ motion)


def build_body_motion(arms: Array) -> Array:
    """Return B (..., 3, 6): velocities of points at arms (..., 3) by linear and angular body
    velocity.
    """
    angular_columns = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=-1)
    identity = np.broadcast_to(np.eye(3), angular_columns.shape)
    return np.concatenate([identity, angular_columns], axis=-1)


def _invert(square: Array) -> Array:
    """Return inverses of matrices (..., R, R), not finite for singular ones."""
    size = square.shape[-1]
    scale = np.sqrt(np.abs(np.einsum("...ii->...i", square)))  # of metres and radians
    scaled = square / np.maximum(scale[..., None] * scale[..., None, :], 1e-300)
    is_finite = np.isfinite(scaled).all(axis=(-1, -2))
    finite_matrix = np.where(is_finite[..., None, None], scaled, np.eye(size))
    is_singular = ~(np.linalg.cond(finite_matrix) < _MAX_CONDITION) | ~is_finite
    inverse = np.linalg.inv(np.where(is_singular[..., None, None], np.eye(size), finite_matrix))
    inverse = inverse / np.maximum(scale[..., None] * scale[..., None, :], 1e-300)
    return np.where(is_singular[..., None, None], np.nan, inverse)


def _invert_transposed(matrix: Array) -> Array:
    """Return inverse transposes of matrices (..., 3, 3) by cross products, which never raises."""
    first, second, third = np.moveaxis(matrix, -1, 0)
    column_products = [np.cross(second, third), np.cross(third, first), np.cross(first, second)]
    volume = (first * column_products[0]).sum(axis=-1)
    return np.asarray(np.stack(column_products, axis=-1) / volume[..., None, None])


def solve_equilibrium(braced: BracedRobot, com: Array, axes: Array) -> StaticEquilibrium:
    """Return the equilibria reached from poses com (K, 3), axes (K, 3, 3)."""
    shift, turn = np.zeros_like(com), np.zeros_like(com)
    size = np.linalg.norm(braced.load[:, :3], axis=1)
    tolerance = _BALANCE_TOLERANCE * np.where(size > 0, size, 1.0)

    def respond(change: Array) -> JointResponse:
        return compute_response(
            braced, com + shift + change[:, :3], _rotate_axes(axes, turn, change[:, 3:])
        )

    no_change = np.zeros((len(com), 6))
    for _ in range(_MAX_ITERATIONS):
        response = respond(no_change)
        stiffness = -_differentiate(respond, no_change)
        step = _solve_step(stiffness, response.wrench)
        residual = np.abs(response.wrench).max(axis=1)
        # The last step is made as well: it takes what the tolerance leaves.
        length = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _MAX_STEP / np.maximum(length, 1e-12))
        shift = shift + step[:, :3]
        turn = _combine_rotations(turn, step[:, 3:])
        if not (residual > tolerance).any():
            break
    response = respond(no_change)
    is_lost = ~(np.abs(response.wrench).max(axis=1) <= tolerance)  # NaN counts as lost
    shift[is_lost], turn[is_lost] = np.nan, np.nan
    stiffness_ratio = _compute_stiffness_ratio(
        braced, com + shift, response.limbs, -_differentiate(respond, no_change)
    )
    stiffness_ratio = np.minimum(
        stiffness_ratio, _compute_self_motion_ratio(braced, _rotate_axes(axes, turn), response)
    )
    stiffness_ratio = np.where(is_lost, np.nan, stiffness_ratio)
    return StaticEquilibrium(
        shift, turn, response.torque, response.force, response.moment, stiffness_ratio
    )


def _differentiate(respond: Callable[[Array], JointResponse], no_change: Array) -> Array:
    """Differentiate the wrench by the body's motion (K, 6, 6), by central differences."""
    columns = []
    for axis in range(6):
        step = no_change.copy()
        step[:, axis] = _DIFFERENCE_STEP
        columns.append((respond(step).wrench - respond(-step).wrench) / (2 * _DIFFERENCE_STEP))
    return np.stack(columns, axis=-1)


def _solve_step(stiffness: Array, wrench: Array) -> Array:
    """Return minimum-norm steps (K, 6) for the wrenches; NaN for matrices that are not finite."""
    is_finite = np.isfinite(stiffness).all(axis=(1, 2))
    step = np.full(wrench.shape, np.nan)
    inverse = np.linalg.pinv(stiffness[is_finite], rcond=1e-10)
    step[is_finite] = (inverse @ wrench[is_finite][..., None])[..., 0]
    return step


def _compute_stiffness_ratio(
    braced: BracedRobot, com: Array, limbs: Limbs, stiffness: Array
) -> Array:
    """Return the smallest eigenvalue of the stiffness (K, 6, 6) relative to that of the joints
    alone.
    """
    spring = braced.robot.joint_stiffness * (1 - braced.robot.structural_compliance_share)
    arms, is_flat = braced.toes - com[:, None, :], braced.soles is not None
    joint_motion = (
        solve_joint_motion(
            build_foot_jacobian(limbs, is_flat), build_foot_motion(arms, is_flat), spring
        )
        * braced.contact[..., None, None]
    )
    elastic = np.einsum("knji,nj,knjl->kil", joint_motion, spring, joint_motion)
    ratio = np.full(len(com), np.nan)
    is_finite = np.isfinite(elastic).all(axis=(1, 2)) & np.isfinite(stiffness).all(axis=(1, 2))
    value, vector = np.linalg.eigh(elastic[is_finite])
    is_resisted = value > _MIN_STIFFNESS_RATIO * value[:, -1:]
    scale = np.divide(1.0, np.sqrt(np.abs(value)), out=np.zeros_like(value), where=is_resisted)
    whitening = vector * scale[:, None, :]
    symmetric = (stiffness + np.swapaxes(stiffness, 1, 2))[is_finite] / 2
    # Directions that no joint resists count as fully stiff: contacts in a line leave them open.
    relative = np.swapaxes(whitening, 1, 2) @ symmetric @ whitening
    relative += np.eye(6) * ~is_resisted[:, None, :]
    ratio[is_finite] = np.linalg.eigvalsh(relative)[:, 0]
    return ratio


def _compute_self_motion_ratio(braced: BracedRobot, axes: Array, response: JointResponse) -> Array:
    """Return the remaining stiffness ratio (K,) of self-motions with toe and body fixed.

    It is 1 for limbs of three joints. Below zero a limb folds away on its own.
    """
    robot = braced.robot
    count = robot.joint_count
    if count == 3 or braced.soles is not None:
        return np.ones(len(axes))
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    local = np.einsum("kij,knj->kni", axes, response.force)
    body = build_chains(require_chain(robot), response.angles)
    root = np.sqrt(spring)
    jacobian = body.jacobian() / root[:, None, :]
    relative_hessian = body.compute_force_hessian(local) / (root[:, :, None] * root[:, None, :])
    is_finite = np.isfinite(jacobian).all(axis=(2, 3)) & np.isfinite(relative_hessian).all(
        axis=(2, 3)
    )
    is_joint = np.abs(body.axes).max(axis=-1) > 0  # (K, N, J)
    ratio = np.ones(len(axes))
    for k, limb in np.argwhere(is_finite & braced.contact):
        joint_mask = is_joint[k, limb]
        self_motions = np.linalg.svd(jacobian[k, limb][:, joint_mask])[2][3:]  # (own - 3, own)
        if len(self_motions):
            loss = (
                self_motions
                @ relative_hessian[k, limb][np.ix_(joint_mask, joint_mask)]
                @ self_motions.T
            )
            ratio[k] = min(ratio[k], 1.0 - float(np.linalg.eigvalsh(loss)[-1]))
    return ratio


def _rotate_axes(axes: Array, *turns: Array) -> Array:
    """Return body axes (K, 3, 3), as rows, after rotation vectors (K, 3) applied in turn."""
    for turn in turns:
        angle = np.linalg.norm(turn, axis=-1)
        axis = turn / np.maximum(angle, 1e-300)[..., None]
        axes = rotate(axes, axis[:, None, :], angle[:, None])
    return axes


def _combine_rotations(first: Array, second: Array) -> Array:
    """Return the rotation vector (K, 3) of two rotations, by unit quaternions."""
    scalar, vector = [], []
    for turn in (first, second):
        half = np.linalg.norm(turn, axis=-1, keepdims=True) / 2
        scalar.append(np.cos(half))
        vector.append(turn / 2 * np.sinc(half / np.pi))
    w = scalar[0] * scalar[1] - (vector[0] * vector[1]).sum(axis=-1, keepdims=True)
    v = scalar[0] * vector[1] + scalar[1] * vector[0] + np.cross(vector[1], vector[0])
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, w)
    return np.asarray(np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0) * v)
