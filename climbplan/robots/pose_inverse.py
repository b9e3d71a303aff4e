"""Inverse kinematics of chains with a given rotation of the last link: feet with a flat sole.

Newton's method starts from the limb's posture. Limbs of six joints have finitely many solutions,
and it finds the one on the posture's side. Steps are damped least squares on six rows, toe and
rotation vector, with joints at a bound fixed there, as in `chain_inverse.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_pose import ChainZero

REACHED = 1e-9  # [m] of a toe from its place, and [rad] of its link
_ITERATIONS = 60
_MAX_TOE_STEP = 0.06  # [m]
_MAX_ROTATION_STEP = 0.2  # [rad]
_DAMPING = 1e-6  # of the largest singular value, squared in the step
_MAX_JOINT_STEP = 0.5  # [rad]


@dataclass(frozen=True)
class PosedAngles:
    """Solutions for F limbs."""

    angles: Array  # (F, J) within the bounds [rad]
    reached: BoolArray  # (F,)
    missing: Array  # (F, 2) distance [m] and angle [rad] left


def pose_inverse(
    chain: ChainZero, posture: Array, toes: Array, turns: Array, lower: Array, upper: Array
) -> PosedAngles:
    """Solve the inverse kinematics of F chains with given positions and rotations, body frame.

    Args:
        chain: F chains of J joints.
        posture: Angles (F, J) to start from [rad].
        toes: Positions (F, 3) [m].
        turns: Rotations (F, 3, 3) of last links from zero angles.
        lower: Lower bounds (F, J) [rad].
        upper: Upper bounds (F, J) [rad].
    """
    angles = np.clip(posture, lower, upper)
    active = np.flatnonzero(np.isfinite(toes).all(axis=-1) & np.isfinite(turns).all(axis=(-1, -2)))
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        q = angles[active]
        pose = chain.rows(active).pose(q)
        offset = toes[active] - pose.toe
        angle_error = rotation_vector(turns[active] @ _transpose(pose.turns[..., -1, :, :]))
        error = np.concatenate(
            [_limit_length(offset, _MAX_TOE_STEP), _limit_length(angle_error, _MAX_ROTATION_STEP)],
            axis=-1,
        )
        rows = np.concatenate([pose.jacobian, pose.turning], axis=-2)  # (A, 6, J)
        step = _compute_step(rows, error, lower[active] - q, upper[active] - q)
        angles[active] = np.clip(q + step, lower[active], upper[active])
        distance = np.maximum(np.linalg.norm(offset, axis=-1), np.linalg.norm(angle_error, axis=-1))
        active = active[distance >= REACHED / 10]
    pose = chain.pose(angles)
    final_angle_error = rotation_vector(turns @ _transpose(pose.turns[..., -1, :, :]))
    missing = np.stack(
        [np.linalg.norm(toes - pose.toe, axis=-1), np.linalg.norm(final_angle_error, axis=-1)],
        axis=-1,
    )
    finite_missing = np.where(np.isnan(missing), np.inf, missing)
    return PosedAngles(angles, np.asarray((missing <= REACHED).all(axis=-1)), finite_missing)


def rotation_vector(rotation: Array) -> Array:
    """Return axis times angle (..., 3) [rad] of rotations (..., 3, 3), less than half a turn."""
    antisymmetric = rotation - _transpose(rotation)
    sine = (
        np.stack(
            [antisymmetric[..., 2, 1], antisymmetric[..., 0, 2], antisymmetric[..., 1, 0]], axis=-1
        )
        / 2
    )
    size = np.linalg.norm(sine, axis=-1)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(size, cosine)
    scale = np.divide(angle, size, out=np.ones_like(angle), where=size > 1e-12)
    return np.asarray(sine * scale[..., None])


def _compute_step(rows: Array, error: Array, down: Array, up: Array) -> Array:
    """Return joint steps (F, J) towards the poses; joints stop at their bounds.

    rows: Jacobians (F, 6, J); error: (F, 6) [m, rad]; down, up: steps (F, J) to the bounds [rad].
    """
    free = np.ones(down.shape, bool)
    fixed = np.zeros(down.shape)
    for _ in range(down.shape[-1]):
        free_rows = rows * free[:, None, :]
        square = free_rows @ _transpose(free_rows)
        size = np.trace(square, axis1=1, axis2=2)[:, None, None]
        residual = error - (rows @ fixed[..., None])[..., 0]
        multiplier = np.linalg.solve(
            square + (_DAMPING * size + 1e-30) * np.eye(6), residual[..., None]
        )
        step = (_transpose(free_rows) @ multiplier)[..., 0]
        largest = np.abs(step).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _MAX_JOINT_STEP / np.maximum(largest, 1e-300))
        is_beyond = free & ((step < down) | (step > up))
        if not is_beyond.any():
            break
        fixed = np.where(is_beyond, np.clip(step, down, up), fixed)
        free &= ~is_beyond
    return np.where(free, step, fixed)


def _limit_length(vector: Array, max_length: float) -> Array:
    """Return vectors with their length limited."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector * np.minimum(1.0, max_length / np.maximum(length, 1e-300)))


def _transpose(matrix: Array) -> Array:
    """Return transposed matrices (..., n, m)."""
    return np.swapaxes(matrix, -1, -2)
