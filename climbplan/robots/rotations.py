"""Rotations by roll, pitch and yaw, and cross-product matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_world_body(rpy: Array) -> Array:
    """Body-to-world rotation R = Rz(yaw) Ry(pitch) Rx(roll).

    rpy: (..., 3) roll, pitch, yaw [rad]. Returns (..., 3, 3).
    """
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(rpy), -1, 0), np.moveaxis(np.cos(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def skew(vector: Array) -> Array:
    """Matrix of the cross product: skew(a) b = a x b, eq. (4.13). (..., 3) to (..., 3, 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
