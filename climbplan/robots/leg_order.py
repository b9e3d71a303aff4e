"""The order of legs: pairs from front to hind, in each the left leg and then the right one.

A quadruped has left front, right front, left hind, right hind. A hexapod has a middle pair between
them. Mirrors and groups of legs follow from this order.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray

MIRROR_POINT = np.array([1.0, -1.0, 1.0])  # of points, velocities and forces
MIRROR_TURN = np.array([-1.0, 1.0, -1.0])  # of angles and angular velocities


def mirror_legs(legs: int) -> IntArray:
    """Return for each leg the one on the other side (L,)."""
    return np.arange(legs, dtype=np.int64) ^ 1


def alternating(legs: int) -> IntArray:
    """Return the groups 0 or 1 (L,) that stand in turn, neighbours in different ones.

    Diagonals of a quadruped, tripods of a hexapod.
    """
    leg = np.arange(legs, dtype=np.int64)
    return (leg // 2 + leg) % 2


def contrasts(legs: int) -> Array:
    """Return orthonormal rows (L - 1, L) that add up to 0: contrasts between the forces of legs.

    Squares of differences over ordered pairs are 2 L times the sum of their squares.
    """
    full: Array = np.kron(_build_helmert_matrix(legs // 2), _build_helmert_matrix(2)).astype(
        np.float64
    )
    return full[1:]


def _build_helmert_matrix(size: int) -> Array:
    """Return the Helmert matrix (size, size): a constant first row, then contrasts."""
    rows = np.ones((size, size))
    for k in range(1, size):
        rows[k] = [1.0] * k + [-float(k)] + [0.0] * (size - k - 1)
    scaled: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return scaled
