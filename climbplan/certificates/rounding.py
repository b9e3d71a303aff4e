"""What floating-point arithmetic of doubles can be off by (Higham 2002, section 3.1).

A sum of K products of doubles, taken in any order, is off by at most K u / (1 - K u) times the sum
of the products' sizes, u = 2^-53. Twice that, and a little for what is too small to be told from
zero, also covers that the sizes are themselves summed in doubles.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

_UNIT, _TINY = 2.0**-52, 1e-300  # 2 u, and what is more than underflow takes


def off_by(terms: Array | int, size: Array | float) -> Array:
    """Largest error of sums of some products whose sizes add up to `size`, any shape."""
    return np.asarray((terms + 4) * (_UNIT * np.abs(size) + _TINY))


def up(value: Array | float) -> Array:
    """A little more than a number."""
    return np.asarray(np.nextafter(value, np.inf))


def down(value: Array | float) -> Array:
    """A little less than a number."""
    return np.asarray(np.nextafter(value, -np.inf))
