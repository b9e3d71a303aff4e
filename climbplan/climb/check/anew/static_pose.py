"""Where bodies settle whose joints are springs about commands, with toes held where they stand.

The nonlinear static equilibrium: limbs reach from the moved body to their toes, joints push with
tau = k (1 - share) (theta - command), contact forces are J^-T tau, and forces and moments balance
the load. Found by Newton's method from a given pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.chains import chains_at
from climbplan.climb.check.anew.kinematics import (
    Limbs,
    chain_of,
    limbs_at,
    standing_limbs,
    turned,
)
from climbplan.robots.model import Robot

_STEP = 1e-6  # [m, rad] of the difference quotients
_LONGEST = 0.05  # [m, rad] of a Newton step
_ITERATIONS = 40
_BALANCED = 1e-7  # of the load [N, N m]
_SINGULAR = 1e14  # condition number of what has no inverse
_RESISTED = 1e-8  # part of the largest stiffness; less is left to the load by contacts in a line


@dataclass(frozen=True)
class Braced:
    """Robots held by K sets of toes."""

    robot: Robot
    toes: Array  # (K, N, 3) that the terrain holds: where feet of finite size touch [m]
    contact: BoolArray  # (K, N)
    command: Array  # (K, N, J) [rad]
    alike: Array  # (K, N, J) joint angles that tell which way the limbs bend [rad]
    load: Array  # (K, 6) force and moment on the body, weight included
    moment: Array | None = None  # (K, N, 3) that wrists bring, at the toes [N m]
    soles: Array | None = None  # (K, N, 3, 3) rows of soles that the terrain holds, of flat feet


@dataclass(frozen=True)
class Pressed:
    """What joints do at given body poses."""

    torque: Array  # (K, N, J) [N m]
    force: Array  # (K, N, 3) on the toes, zero without contact [N]
    moment: Array  # (K, N, 3) on soles, about the toes, else zero [N m]
    wrench: Array  # (K, 6) of forces and load [N, N m]
    limbs: Limbs
    angles: Array  # (K, N, J) [rad]


@dataclass(frozen=True)
class Settled:
    """The equilibrium, and how firm it is."""

    shift: Array  # (K, 3) of the body from where it started [m], NaN if there is none
    turn: Array  # (K, 3) rotation vector likewise [rad]
    torque: Array  # (K, N, J) [N m]
    force: Array  # (K, N, 3) [N]
    moment: Array  # (K, N, 3) on soles, about the toes [N m]
    stiffness_left: Array  # (K,) least share of the joints' stiffness left under load; < 0: buckles


def pressed(braced: Braced, com: Array, axes: Array) -> Pressed:
    """Torques and forces for bodies at com (K, 3) with axes (K, 3, 3)."""
    robot = braced.robot
    angles = standing_limbs(
        robot, com, axes, braced.toes, braced.alike, braced.command, soles=braced.soles
    ).angles
    limbs = limbs_at(robot, com, axes, angles)
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    torque = spring * (angles - braced.command) * braced.contact[..., None]
    by_force = torque
    if braced.moment is not None:  # part of what the joints hold
        by_force = torque - (limbs.turning() @ braced.moment[..., None])[..., 0]
    held = held_rows(limbs, braced.soles is not None)
    push = np.where(braced.contact[..., None], force_of(held, by_force), 0.0)
    force, own = push[..., :3], push[..., 3:]
    moment = np.cross(braced.toes - com[..., None, :], force).sum(axis=-2)
    if braced.soles is None:
        own = np.zeros_like(force)
    else:
        moment = moment + own.sum(axis=-2)
    if braced.moment is not None:
        moment = moment + braced.moment.sum(axis=-2)
    wrench = np.concatenate([force.sum(axis=-2), moment], axis=-1) + braced.load
    return Pressed(torque, force, own, wrench, limbs, angles)


def held_rows(limbs: Limbs, flat: bool) -> Array:
    """(..., N, R, J) what the terrain holds of limbs by joint speed: toes, or soles, R = 3 or 6."""
    if not flat:
        return limbs.jacobian()
    turning = np.swapaxes(limbs.turning(), -1, -2)
    return np.concatenate([limbs.jacobian(), turning], axis=-2)


def held_motion(arms: Array, flat: bool) -> Array:
    """(..., R, 6) the same by the motion of the body, for toes at arms (..., 3) from its origin."""
    motion = body_motion(arms)
    if not flat:
        return motion
    turning = np.broadcast_to(np.eye(3, 6, 3), motion.shape)
    return np.concatenate([motion, turning], axis=-2)


def force_of(jacobian: Array, torque: Array) -> Array:
    """J^-T tau (..., R), not finite where J is singular; of least squares for limbs with a choice.

    jacobian: (..., R, J). Settled joints of such a limb have torques J^T f, so that no square is
    left.
    """
    if jacobian.shape[-2] != 3:
        square = jacobian @ np.swapaxes(jacobian, -1, -2)
        return np.asarray((_inverse(square) @ (jacobian @ torque[..., None]))[..., 0])
    if jacobian.shape[-1] != 3:
        square = jacobian @ np.swapaxes(jacobian, -1, -2)
        torque = (jacobian @ torque[..., None])[..., 0]
        return np.asarray((_inverse_transposed(square) @ torque[..., None])[..., 0])
    return np.asarray((_inverse_transposed(jacobian) @ torque[..., None])[..., 0])


def joints_by_body(jacobian: Array, motion: Array, spring: Array) -> Array:
    """J^-1 B (..., J, 6): joint turns that answer toe motions B, not finite where J is singular.

    Where a limb has a choice its springs (N, J) turn with the least energy.
    """
    if jacobian.shape[-2] != 3:
        soft = np.swapaxes(jacobian, -1, -2) / spring[..., None]
        return np.asarray(soft @ _inverse(jacobian @ soft) @ motion)
    if jacobian.shape[-1] != 3:
        soft = np.swapaxes(jacobian, -1, -2) / spring[..., None]
        return np.asarray(soft @ _inverse_transposed(jacobian @ soft) @ motion)
    return np.asarray(np.swapaxes(_inverse_transposed(jacobian), -1, -2) @ motion)


def body_motion(arms: Array) -> Array:
    """B (..., 3, 6): velocities of points at arms (..., 3) by those of the body and its turning."""
    turning = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=-1)
    identity = np.broadcast_to(np.eye(3), turning.shape)
    return np.concatenate([identity, turning], axis=-1)


def _inverse(square: Array) -> Array:
    """Of matrices (..., R, R), not finite for those that have none."""
    size = square.shape[-1]
    scale = np.sqrt(np.abs(np.einsum("...ii->...i", square)))  # of metres and radians
    even = square / np.maximum(scale[..., None] * scale[..., None, :], 1e-300)
    fine = np.isfinite(even).all(axis=(-1, -2))
    safe = np.where(fine[..., None, None], even, np.eye(size))
    lost = ~(np.linalg.cond(safe) < _SINGULAR) | ~fine
    inverse = np.linalg.inv(np.where(lost[..., None, None], np.eye(size), safe))
    inverse = inverse / np.maximum(scale[..., None] * scale[..., None, :], 1e-300)
    return np.where(lost[..., None, None], np.nan, inverse)


def _inverse_transposed(matrix: Array) -> Array:
    """By cross products of the columns (..., 3, 3), which never raises."""
    first, second, third = np.moveaxis(matrix, -1, 0)
    faces = [np.cross(second, third), np.cross(third, first), np.cross(first, second)]
    volume = (first * faces[0]).sum(axis=-1)
    return np.asarray(np.stack(faces, axis=-1) / volume[..., None, None])


def settle(braced: Braced, com: Array, axes: Array) -> Settled:
    """Equilibria found from poses com (K, 3), axes (K, 3, 3)."""
    shift, turn = np.zeros_like(com), np.zeros_like(com)
    size = np.linalg.norm(braced.load[:, :3], axis=1)
    enough = _BALANCED * np.where(size > 0, size, 1.0)

    def at(change: Array) -> Pressed:
        return pressed(braced, com + shift + change[:, :3], _rotated(axes, turn, change[:, 3:]))

    still = np.zeros((len(com), 6))
    for _ in range(_ITERATIONS):
        now = at(still)
        stiffness = -_slope(at, still)
        step = _solved(stiffness, now.wrench)
        off = np.abs(now.wrench).max(axis=1)
        # The last step is made as well: it takes what the tolerance leaves.
        length = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST / np.maximum(length, 1e-12))
        shift = shift + step[:, :3]
        turn = _combined(turn, step[:, 3:])
        if not (off > enough).any():
            break
    now = at(still)
    lost = ~(np.abs(now.wrench).max(axis=1) <= enough)  # NaN counts as lost
    shift[lost], turn[lost] = np.nan, np.nan
    left = _stiffness_left(braced, com + shift, now.limbs, -_slope(at, still))
    left = np.minimum(left, _choice_left(braced, _rotated(axes, turn), now))
    left = np.where(lost, np.nan, left)
    return Settled(shift, turn, now.torque, now.force, now.moment, left)


def _slope(at: Callable[[Array], Pressed], still: Array) -> Array:
    """(K, 6, 6) derivatives of the wrench by the body's motion."""
    columns = []
    for axis in range(6):
        step = still.copy()
        step[:, axis] = _STEP
        columns.append((at(step).wrench - at(-step).wrench) / (2 * _STEP))
    return np.stack(columns, axis=-1)


def _solved(stiffness: Array, wrench: Array) -> Array:
    """Least steps (K, 6) that answer the wrenches; NaN for matrices that are not finite."""
    fine = np.isfinite(stiffness).all(axis=(1, 2))
    step = np.full(wrench.shape, np.nan)
    inverse = np.linalg.pinv(stiffness[fine], rcond=1e-10)
    step[fine] = (inverse @ wrench[fine][..., None])[..., 0]
    return step


def _stiffness_left(braced: Braced, com: Array, limbs: Limbs, stiffness: Array) -> Array:
    """Least eigenvalue of the stiffness (K, 6, 6) relative to that of the joints alone."""
    spring = braced.robot.joint_stiffness * (1 - braced.robot.structural_compliance_share)
    arms, flat = braced.toes - com[:, None, :], braced.soles is not None
    bend = (
        joints_by_body(held_rows(limbs, flat), held_motion(arms, flat), spring)
        * braced.contact[..., None, None]
    )
    elastic = np.einsum("knji,nj,knjl->kil", bend, spring, bend)
    left = np.full(len(com), np.nan)
    fine = np.isfinite(elastic).all(axis=(1, 2)) & np.isfinite(stiffness).all(axis=(1, 2))
    value, vector = np.linalg.eigh(elastic[fine])
    resisted = value > _RESISTED * value[:, -1:]
    scale = np.divide(1.0, np.sqrt(np.abs(value)), out=np.zeros_like(value), where=resisted)
    whitening = vector * scale[:, None, :]
    even = (stiffness + np.swapaxes(stiffness, 1, 2))[fine] / 2
    # Directions that no joint resists count as fully stiff: contacts in a line leave them open.
    share = np.swapaxes(whitening, 1, 2) @ even @ whitening
    share += np.eye(6) * ~resisted[:, None, :]
    left[fine] = np.linalg.eigvalsh(share)[:, 0]
    return left


def _choice_left(braced: Braced, axes: Array, now: Pressed) -> Array:
    """Share of their stiffness (K,) left to joints that may turn while toe and body stand still.

    Of limbs with more than three joints; 1 for others. Below zero a limb folds away by itself.
    """
    robot = braced.robot
    count = robot.joint_count
    if count == 3 or braced.soles is not None:
        return np.ones(len(axes))
    spring = robot.joint_stiffness * (1 - robot.structural_compliance_share)
    local = np.einsum("kij,knj->kni", axes, now.force)
    body = chains_at(chain_of(robot), now.angles)
    root = np.sqrt(spring)
    jacobian = body.jacobian() / root[:, None, :]
    share = body.bending(local) / (root[:, :, None] * root[:, None, :])
    fine = np.isfinite(jacobian).all(axis=(2, 3)) & np.isfinite(share).all(axis=(2, 3))
    there = np.abs(body.axes).max(axis=-1) > 0  # (K, N, J)
    left = np.ones(len(axes))
    for k, limb in np.argwhere(fine & braced.contact):
        own = there[k, limb]
        free = np.linalg.svd(jacobian[k, limb][:, own])[2][3:]  # (own - 3, own)
        if len(free):
            lost = free @ share[k, limb][np.ix_(own, own)] @ free.T
            left[k] = min(left[k], 1.0 - float(np.linalg.eigvalsh(lost)[-1]))
    return left


def _rotated(axes: Array, *turns: Array) -> Array:
    """Body axes (K, 3, 3), as rows, turned by rotation vectors (K, 3) one after the other."""
    for turn in turns:
        angle = np.linalg.norm(turn, axis=-1)
        axis = turn / np.maximum(angle, 1e-300)[..., None]
        axes = turned(axes, axis[:, None, :], angle[:, None])
    return axes


def _combined(first: Array, then: Array) -> Array:
    """Rotation vector (K, 3) of two rotations, by unit quaternions."""
    scalar, vector = [], []
    for turn in (first, then):
        half = np.linalg.norm(turn, axis=-1, keepdims=True) / 2
        scalar.append(np.cos(half))
        vector.append(turn / 2 * np.sinc(half / np.pi))
    w = scalar[0] * scalar[1] - (vector[0] * vector[1]).sum(axis=-1, keepdims=True)
    v = scalar[0] * vector[1] + scalar[1] * vector[0] + np.cross(vector[1], vector[0])
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, w)
    return np.asarray(np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0) * v)
