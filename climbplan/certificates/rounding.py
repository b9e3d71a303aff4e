"""Bounds on the rounding errors of double arithmetic (Higham 2002, section 3.1).

A sum of K products of doubles, taken in any order, has an error of at most K u / (1 - K u) times
the sum of the products' sizes, u = 2^-53. Twice that, and a little against underflow, also covers
that the sizes are themselves summed in doubles.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

_UNIT, _TINY = 2.0**-52, 1e-300  # 2 u, and more than the error of underflow


def bound_error(terms: Array | int, size: Array | float) -> Array:
    """Return the largest error of sums of products whose sizes add up to `size`, any shape."""
    return np.asarray((terms + 4) * (_UNIT * np.abs(size) + _TINY))


def round_up(value: Array | float) -> Array:
    """Return the next larger number."""
    return np.asarray(np.nextafter(value, np.inf))


def round_down(value: Array | float) -> Array:
    """Return the next smaller number."""
    return np.asarray(np.nextafter(value, -np.inf))
