"""Inverse kinematics of chains whose last link is to lie as it is asked to: feet with a flat sole.

Of all angles within their bounds that put a toe at its place with its link turned as asked, those
that Newton's method finds from the limb's posture: of limbs of six joints there are finitely many,
and this is the one on the posture's side. Steps are damped least squares on six rows, toe and
rotation vector, joints at a bound held there, as in `chain_inverse.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_pose import ChainZero

REACHED = 1e-9  # [m] of a toe from its place, and [rad] of its link
_ITERATIONS = 60
_STRIDE = 0.06  # [m] towards the place in one step, and
_TURN = 0.2  # [rad]
_DAMPING = 1e-6  # of the largest singular value, squared in the step
_LONGEST = 0.5  # [rad] turned by a joint in one step


@dataclass(frozen=True)
class PosedAngles:
    """Answers for F limbs."""

    angles: Array  # (F, J) within the bounds [rad]
    reached: BoolArray  # (F,)
    missing: Array  # (F, 2) distance [m] and angle [rad] left


def pose_inverse(
    chain: ChainZero, posture: Array, toes: Array, turns: Array, lower: Array, upper: Array
) -> PosedAngles:
    """Angles of F chains that put toes at (F, 3) with last links turned by (F, 3, 3), body frame.

    turns: from zero angles; posture, lower, upper: (F, J).
    """
    angles = np.clip(posture, lower, upper)
    active = np.flatnonzero(np.isfinite(toes).all(axis=-1) & np.isfinite(turns).all(axis=(-1, -2)))
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        q = angles[active]
        pose = chain.rows(active).pose(q)
        away = toes[active] - pose.toe
        turned = rotation_vector(turns[active] @ _transposed(pose.turns[..., -1, :, :]))
        error = np.concatenate([_shortened(away, _STRIDE), _shortened(turned, _TURN)], axis=-1)
        rows = np.concatenate([pose.jacobian, pose.turning], axis=-2)  # (A, 6, J)
        step = _step(rows, error, lower[active] - q, upper[active] - q)
        angles[active] = np.clip(q + step, lower[active], upper[active])
        off = np.maximum(np.linalg.norm(away, axis=-1), np.linalg.norm(turned, axis=-1))
        active = active[off >= REACHED / 10]
    pose = chain.pose(angles)
    left = rotation_vector(turns @ _transposed(pose.turns[..., -1, :, :]))
    missing = np.stack(
        [np.linalg.norm(toes - pose.toe, axis=-1), np.linalg.norm(left, axis=-1)], axis=-1
    )
    known = np.where(np.isnan(missing), np.inf, missing)
    return PosedAngles(angles, np.asarray((missing <= REACHED).all(axis=-1)), known)


def rotation_vector(rotation: Array) -> Array:
    """(..., 3) axis times angle [rad] of rotations (..., 3, 3), less than half a turn."""
    odd = rotation - _transposed(rotation)
    sine = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1) / 2
    size = np.linalg.norm(sine, axis=-1)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(size, cosine)
    scale = np.divide(angle, size, out=np.ones_like(angle), where=size > 1e-12)
    return np.asarray(sine * scale[..., None])


def _step(rows: Array, error: Array, down: Array, up: Array) -> Array:
    """Joint turns (F, J) towards the poses; joints that would leave bounds are put on them."""
    free = np.ones(down.shape, bool)
    held = np.zeros(down.shape)
    for _ in range(down.shape[-1]):
        part = rows * free[:, None, :]
        square = part @ _transposed(part)
        size = np.trace(square, axis1=1, axis2=2)[:, None, None]
        left = error - (rows @ held[..., None])[..., 0]
        answer = np.linalg.solve(square + (_DAMPING * size + 1e-30) * np.eye(6), left[..., None])
        step = (_transposed(part) @ answer)[..., 0]
        most = np.abs(step).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _LONGEST / np.maximum(most, 1e-300))
        beyond = free & ((step < down) | (step > up))
        if not beyond.any():
            break
        held = np.where(beyond, np.clip(step, down, up), held)
        free &= ~beyond
    return np.where(free, step, held)


def _shortened(vector: Array, most: float) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector * np.minimum(1.0, most / np.maximum(length, 1e-300)))


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)
