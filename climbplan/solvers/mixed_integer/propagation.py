"""Bounds through plain rows and through conditional ones, and integers that they leave one value.

Interval arithmetic in compiled code, row by row until nothing moves; every bound is let out by a
little more than rounding. A conditional row that cannot hold takes its value from its integer; one
whose integer is decided is a plain row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_PROGRESS = 1e-3  # share of a range by which a bound must move to be worth another look
_ROUNDING = 1e-9
_WEAK = 1e-7  # entries below this share of a row's largest bound no variable
_CROSSED = 1e-7  # bounds that cross by more are a proof that nothing is feasible

Pointer = NDArray[np.int32]


@compiled
def _tighten(
    begin: int,
    end: int,
    index: Pointer,
    data: Array,
    low: float,
    high: float,
    lower: Array,
    upper: Array,
    integer: BoolArray,
) -> int:
    """Bounds of a row's variables from the others'; 1 if one moved, -1 if they cross."""
    least, most = 0.0, 0.0
    open_low, open_high = 0, 0
    top = 0.0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if a == 0.0:
            continue
        top = max(top, abs(a))
        one, other = (lower[j], upper[j]) if a > 0 else (upper[j], lower[j])
        if np.isinf(one):
            open_low += 1
        else:
            least += a * one
        if np.isinf(other):
            open_high += 1
        else:
            most += a * other
    size = max(1.0, max(abs(least), abs(most)))
    if open_low == 0 and least > high + _CROSSED * size:
        return -1
    if open_high == 0 and most < low - _CROSSED * size:
        return -1
    moved = 0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if abs(a) <= _WEAK * top:
            continue
        one, other = (lower[j], upper[j]) if a > 0 else (upper[j], lower[j])
        new_low, new_high = -np.inf, np.inf
        if not np.isinf(high) and open_low - np.isinf(one) == 0:
            rest = least - (0.0 if np.isinf(one) else a * one)
            room = (high - rest) / a
            if a > 0:
                new_high = room + _ROUNDING * size / abs(a)
            else:
                new_low = room - _ROUNDING * size / abs(a)
        if not np.isinf(low) and open_high - np.isinf(other) == 0:
            rest = most - (0.0 if np.isinf(other) else a * other)
            room = (low - rest) / a
            if a > 0:
                new_low = max(new_low, room - _ROUNDING * size / abs(a))
            else:
                new_high = min(new_high, room + _ROUNDING * size / abs(a))
        if integer[j]:
            new_low = np.ceil(new_low - 1e-6) if not np.isinf(new_low) else new_low
            new_high = np.floor(new_high + 1e-6) if not np.isinf(new_high) else new_high
        width = max(upper[j] - lower[j], _ROUNDING)
        if new_low > lower[j]:
            if np.isinf(lower[j]) or new_low - lower[j] > _PROGRESS * width:
                moved = 1
            lower[j] = new_low
        if new_high < upper[j]:
            if np.isinf(upper[j]) or upper[j] - new_high > _PROGRESS * width:
                moved = 1
            upper[j] = new_high
        if lower[j] > upper[j]:
            if lower[j] > upper[j] + _CROSSED * max(1.0, abs(lower[j])):
                return -1
            lower[j], upper[j] = upper[j], lower[j]  # by rounding: one point, let out a little
    return moved


@compiled
def interval(
    begin: int, end: int, index: Pointer, data: Array, lower: Array, upper: Array
) -> tuple[float, float]:
    """Least and largest value of a row over the box."""
    least, most = 0.0, 0.0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if a > 0.0:
            least += a * lower[j]
            most += a * upper[j]
        elif a < 0.0:
            least += a * upper[j]
            most += a * lower[j]
    return least, most


@compiled
def propagate(
    pointer: Pointer,
    index: Pointer,
    data: Array,
    row_lower: Array,
    row_upper: Array,
    when_pointer: Pointer,
    when_index: Pointer,
    when_data: Array,
    when_lower: Array,
    when_upper: Array,
    when: IntArray,
    value: IntArray,
    integer: BoolArray,
    lower: Array,
    upper: Array,
    rounds: int,
) -> bool:
    """Tighten lower and upper in place; False if nothing is feasible."""
    for _ in range(rounds):
        moved = False
        for r in range(len(row_lower)):
            found = _tighten(
                pointer[r], pointer[r + 1], index, data, row_lower[r], row_upper[r], lower, upper,
                integer,
            )  # fmt: skip
            if found < 0:
                return False
            moved = moved or found > 0
        for r in range(len(when_lower)):
            b, begin, end = when[r], when_pointer[r], when_pointer[r + 1]
            if lower[b] < upper[b]:
                least, most = interval(begin, end, when_index, when_data, lower, upper)
                size = 1.0
                if not np.isinf(least):
                    size = max(size, abs(least))
                if not np.isinf(most):
                    size = max(size, abs(most))
                if (
                    least > when_upper[r] + _CROSSED * size
                    or most < when_lower[r] - _CROSSED * size
                ):
                    lower[b] = upper[b] = 1.0 - value[r]
                    moved = True
            elif lower[b] == value[r]:
                found = _tighten(
                    begin, end, when_index, when_data, when_lower[r], when_upper[r], lower, upper,
                    integer,
                )  # fmt: skip
                if found < 0:
                    return False
                moved = moved or found > 0
        if not moved:
            break
    return True
