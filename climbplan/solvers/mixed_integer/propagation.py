"""Feasibility-based bound tightening through plain rows and indicator rows.

Interval arithmetic is applied row by row until bounds no longer move (Savelsbergh 1994). Every
bound is relaxed by a little more than rounding errors. An indicator row that cannot hold fixes its
binary to the other value; one whose binary is fixed acts as a plain row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_PROGRESS = 1e-3  # fraction of a range by which a bound must move to count as progress
_ROUNDING = 1e-9
_WEAK = 1e-7  # entries below this fraction of a row's largest entry tighten no variable
_CROSSED = 1e-7  # bounds that cross by more prove infeasibility

Pointer = NDArray[np.int32]


@compiled
def _tighten_row(
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
    """Tighten the bounds of a row's variables; return 1 on progress, -1 if infeasible, else 0."""
    min_activity, max_activity = 0.0, 0.0
    num_infinite_min, num_infinite_max = 0, 0
    max_entry = 0.0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if a == 0.0:
            continue
        max_entry = max(max_entry, abs(a))
        low_end, high_end = (lower[j], upper[j]) if a > 0 else (upper[j], lower[j])
        if np.isinf(low_end):
            num_infinite_min += 1
        else:
            min_activity += a * low_end
        if np.isinf(high_end):
            num_infinite_max += 1
        else:
            max_activity += a * high_end
    size = max(1.0, max(abs(min_activity), abs(max_activity)))
    if num_infinite_min == 0 and min_activity > high + _CROSSED * size:
        return -1
    if num_infinite_max == 0 and max_activity < low - _CROSSED * size:
        return -1
    progress = 0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if abs(a) <= _WEAK * max_entry:
            continue
        low_end, high_end = (lower[j], upper[j]) if a > 0 else (upper[j], lower[j])
        new_low, new_high = -np.inf, np.inf
        if not np.isinf(high) and num_infinite_min - np.isinf(low_end) == 0:
            residual_activity = min_activity - (0.0 if np.isinf(low_end) else a * low_end)
            implied_bound = (high - residual_activity) / a
            if a > 0:
                new_high = implied_bound + _ROUNDING * size / abs(a)
            else:
                new_low = implied_bound - _ROUNDING * size / abs(a)
        if not np.isinf(low) and num_infinite_max - np.isinf(high_end) == 0:
            residual_activity = max_activity - (0.0 if np.isinf(high_end) else a * high_end)
            implied_bound = (low - residual_activity) / a
            if a > 0:
                new_low = max(new_low, implied_bound - _ROUNDING * size / abs(a))
            else:
                new_high = min(new_high, implied_bound + _ROUNDING * size / abs(a))
        if integer[j]:
            new_low = np.ceil(new_low - 1e-6) if not np.isinf(new_low) else new_low
            new_high = np.floor(new_high + 1e-6) if not np.isinf(new_high) else new_high
        width = max(upper[j] - lower[j], _ROUNDING)
        if new_low > lower[j]:
            if np.isinf(lower[j]) or new_low - lower[j] > _PROGRESS * width:
                progress = 1
            lower[j] = new_low
        if new_high < upper[j]:
            if np.isinf(upper[j]) or upper[j] - new_high > _PROGRESS * width:
                progress = 1
            upper[j] = new_high
        if lower[j] > upper[j]:
            if lower[j] > upper[j] + _CROSSED * max(1.0, abs(lower[j])):
                return -1
            lower[j], upper[j] = upper[j], lower[j]  # crossed by rounding errors only
    return progress


@compiled
def compute_interval(
    begin: int, end: int, index: Pointer, data: Array, lower: Array, upper: Array
) -> tuple[float, float]:
    """Return the minimum and the maximum activity of a row over the box."""
    min_activity, max_activity = 0.0, 0.0
    for e in range(begin, end):
        a, j = data[e], index[e]
        if a > 0.0:
            min_activity += a * lower[j]
            max_activity += a * upper[j]
        elif a < 0.0:
            min_activity += a * upper[j]
            max_activity += a * lower[j]
    return min_activity, max_activity


@compiled
def propagate_bounds(
    pointer: Pointer,
    index: Pointer,
    data: Array,
    row_lower: Array,
    row_upper: Array,
    indicator_pointer: Pointer,
    indicator_index: Pointer,
    indicator_data: Array,
    indicator_lower: Array,
    indicator_upper: Array,
    indicator: IntArray,
    value: IntArray,
    integer: BoolArray,
    lower: Array,
    upper: Array,
    max_rounds: int,
) -> bool:
    """Tighten `lower` and `upper` in place; return False if nothing is feasible."""
    for _ in range(max_rounds):
        has_progress = False
        for r in range(len(row_lower)):
            outcome = _tighten_row(
                pointer[r], pointer[r + 1], index, data, row_lower[r], row_upper[r], lower, upper,
                integer,
            )  # fmt: skip
            if outcome < 0:
                return False
            has_progress = has_progress or outcome > 0
        for r in range(len(indicator_lower)):
            b, begin, end = indicator[r], indicator_pointer[r], indicator_pointer[r + 1]
            if lower[b] < upper[b]:
                min_activity, max_activity = compute_interval(
                    begin, end, indicator_index, indicator_data, lower, upper
                )
                size = 1.0
                if not np.isinf(min_activity):
                    size = max(size, abs(min_activity))
                if not np.isinf(max_activity):
                    size = max(size, abs(max_activity))
                if (
                    min_activity > indicator_upper[r] + _CROSSED * size
                    or max_activity < indicator_lower[r] - _CROSSED * size
                ):
                    lower[b] = upper[b] = 1.0 - value[r]
                    has_progress = True
            elif lower[b] == value[r]:
                outcome = _tighten_row(
                    begin, end, indicator_index, indicator_data, indicator_lower[r],
                    indicator_upper[r], lower, upper, integer,
                )  # fmt: skip
                if outcome < 0:
                    return False
                has_progress = has_progress or outcome > 0
        if not has_progress:
            break
    return True
