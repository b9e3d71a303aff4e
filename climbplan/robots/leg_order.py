"""The order of legs: pairs from front to hind, of each the left leg and then the right one.

Left front, right front, left hind, right hind of a quadruped; a hexapod has a middle pair between
them. What is said of legs in turn, in mirrors and in groups follows from it.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray

MIRROR_POINT = np.array([1.0, -1.0, 1.0])  # of points, velocities and forces
MIRROR_TURN = np.array([-1.0, 1.0, -1.0])  # of angles and angular velocities


def mirror_legs(legs: int) -> IntArray:
    """(L,) the leg on the other side of each."""
    return np.arange(legs, dtype=np.int64) ^ 1


def alternating(legs: int) -> IntArray:
    """(L,) 0 or 1: groups that stand in turn, neighbours in different ones.

    Diagonals of a quadruped, tripods of a hexapod.
    """
    leg = np.arange(legs, dtype=np.int64)
    return (leg // 2 + leg) % 2


def contrasts(legs: int) -> Array:
    """(L - 1, L) orthonormal rows that add up to 0: all that sets forces of legs apart.

    Squares of differences over ordered pairs are 2 L times the sum of their squares.
    """
    every: Array = np.kron(_orthonormal(legs // 2), _orthonormal(2)).astype(np.float64)
    return every[1:]


def _orthonormal(size: int) -> Array:
    """Helmert's matrix (size, size): its first row is even, each other sets one apart."""
    rows = np.ones((size, size))
    for k in range(1, size):
        rows[k] = [1.0] * k + [-float(k)] + [0.0] * (size - k - 1)
    scaled: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return scaled
