"""Rotations by roll, pitch and yaw, and cross-product matrices.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

_OPPOSITE = 1e-9  # of 1 + cosine, below which vectors count as opposite


def rotation_world_body(rpy: Array) -> Array:
    """Return the body-to-world rotation R = Rz(yaw) Ry(pitch) Rx(roll).

    rpy: (..., 3) roll, pitch, yaw [rad]. Returns (..., 3, 3).
    """
    sines, cosines = np.sin(rpy), np.cos(rpy)
    sr, sp, sy = sines[..., 0], sines[..., 1], sines[..., 2]
    cr, cp, cy = cosines[..., 0], cosines[..., 1], cosines[..., 2]
    R: Array = np.empty((*sr.shape, 3, 3))  # filled: faster than stacking rows
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = (
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
    )
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = (
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
    )
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -sp, cp * sr, cp * cr
    return R


def skew(vector: Array) -> Array:
    """Return the matrix of the cross product: skew(a) b = a x b, eq. (4.13).

    vector: (..., 3). Returns (..., 3, 3).
    """
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def frame_in_plane(out: Array, tilt: Array) -> Array:
    """Return the axes of a link in an upright plane as rows (..., 3, 3), body frame.

    out: (..., 3) level unit vectors in the plane; tilt: (...) of the link from straight down
    towards
    them [rad]. x is along the link, y across it, upwards where it points outward, z is normal to
    the
    plane.
    """
    sin, cos = np.sin(tilt)[..., None], np.cos(tilt)[..., None]
    up = np.array([0.0, 0.0, 1.0])
    x, y = sin * out - cos * up, cos * out + sin * up
    return np.stack([x, y, np.cross(x, y)], axis=-2)


def turn_between(first: Array, then: Array) -> Array:
    """Return the smallest rotation (..., 3, 3) that takes unit vectors (..., 3) to others (..., 3).

    Opposite vectors have no smallest rotation: it is half a turn about an axis normal to them.
    """
    first, then = np.broadcast_arrays(first, then)
    cosine = (first * then).sum(axis=-1)[..., None, None]
    cross = skew(np.cross(first, then))
    factor = np.divide(1.0, 1.0 + cosine, out=np.zeros_like(cosine), where=cosine > _OPPOSITE - 1.0)
    turn = np.eye(3) + cross + factor * (cross @ cross)
    axis = np.cross(first, np.where(np.abs(first[..., :1]) < 0.9, np.eye(3)[0], np.eye(3)[1]))
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    half = 2 * axis[..., :, None] * axis[..., None, :] - np.eye(3)
    return np.asarray(np.where(cosine > _OPPOSITE - 1.0, turn, half))
