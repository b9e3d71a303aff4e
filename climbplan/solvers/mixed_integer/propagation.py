"""Feasibility-based bound tightening through plain rows and indicator rows.

Interval arithmetic is applied row by row until bounds no longer move (Savelsbergh 1994). Every
bound is relaxed by a little more than rounding errors. An indicator row that cannot hold fixes its
binary to the other value; one whose binary is fixed acts as a plain row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_PROGRESS = 1e-3  # fraction of a range by which a bound must move to count as progress
_ROUNDING = 1e-9
_WEAK = 1e-7  # entries below this fraction of a row's largest entry tighten no variable
_CROSSED = 1e-7  # bounds that cross by more prove infeasibility

Pointer = NDArray[np.int32]


class SparseRows(NamedTuple):
    """Rows lower <= A x <= upper with A in compressed sparse row format."""

    pointer: Pointer  # (m + 1,) begin of each row in the next two
    columns: Pointer  # variable of each entry
    data: Array
    lower: Array  # (m,)
    upper: Array  # (m,)


class _Activity(NamedTuple):
    """Extreme activities of a row over the box, without infinite contributions."""

    minimum: float
    maximum: float
    num_infinite_min: int  # variables whose contribution to the minimum is infinite
    num_infinite_max: int
    max_entry: float  # largest absolute coefficient


@compiled
def _compute_activity(rows: SparseRows, r: int, lower: Array, upper: Array) -> _Activity:
    """Compute the extreme activities of row r over the box."""
    minimum, maximum = 0.0, 0.0
    num_infinite_min, num_infinite_max = 0, 0
    max_entry = 0.0
    for e in range(rows.pointer[r], rows.pointer[r + 1]):
        a, j = rows.data[e], rows.columns[e]
        if a == 0.0:
            continue
        max_entry = max(max_entry, abs(a))
        low_end, high_end = (lower[j], upper[j]) if a > 0 else (upper[j], lower[j])
        if np.isinf(low_end):
            num_infinite_min += 1
        else:
            minimum += a * low_end
        if np.isinf(high_end):
            num_infinite_max += 1
        else:
            maximum += a * high_end
    return _Activity(minimum, maximum, num_infinite_min, num_infinite_max, max_entry)


@compiled
def _imply_bounds(
    a: float, low: float, high: float, lower: float, upper: float, activity: _Activity
) -> tuple[float, float]:
    """Return the bounds that low <= row <= high implies for a variable of coefficient a.

    lower and upper are its bounds by now; they enter the extreme activities of the row.
    """
    size = max(1.0, max(abs(activity.minimum), abs(activity.maximum)))
    low_end, high_end = (lower, upper) if a > 0 else (upper, lower)
    new_low, new_high = -np.inf, np.inf
    if not np.isinf(high) and activity.num_infinite_min - np.isinf(low_end) == 0:
        residual_activity = activity.minimum - (0.0 if np.isinf(low_end) else a * low_end)
        implied_bound = (high - residual_activity) / a
        if a > 0:
            new_high = implied_bound + _ROUNDING * size / abs(a)
        else:
            new_low = implied_bound - _ROUNDING * size / abs(a)
    if not np.isinf(low) and activity.num_infinite_max - np.isinf(high_end) == 0:
        residual_activity = activity.maximum - (0.0 if np.isinf(high_end) else a * high_end)
        implied_bound = (low - residual_activity) / a
        if a > 0:
            new_low = max(new_low, implied_bound - _ROUNDING * size / abs(a))
        else:
            new_high = min(new_high, implied_bound + _ROUNDING * size / abs(a))
    return new_low, new_high


@compiled
def _update_bounds(j: int, new_low: float, new_high: float, lower: Array, upper: Array) -> int:
    """Intersect the range of variable j; return 1 on progress, -1 if it is empty, else 0."""
    progress = 0
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
def _tighten_row(rows: SparseRows, r: int, lower: Array, upper: Array, integer: BoolArray) -> int:
    """Tighten the bounds of a row's variables; return 1 on progress, -1 if infeasible, else 0."""
    low, high = rows.lower[r], rows.upper[r]
    activity = _compute_activity(rows, r, lower, upper)
    size = max(1.0, max(abs(activity.minimum), abs(activity.maximum)))
    if activity.num_infinite_min == 0 and activity.minimum > high + _CROSSED * size:
        return -1
    if activity.num_infinite_max == 0 and activity.maximum < low - _CROSSED * size:
        return -1
    progress = 0
    for e in range(rows.pointer[r], rows.pointer[r + 1]):
        a, j = rows.data[e], rows.columns[e]
        if abs(a) <= _WEAK * activity.max_entry:
            continue
        new_low, new_high = _imply_bounds(a, low, high, lower[j], upper[j], activity)
        if integer[j]:
            new_low = np.ceil(new_low - 1e-6) if not np.isinf(new_low) else new_low
            new_high = np.floor(new_high + 1e-6) if not np.isinf(new_high) else new_high
        outcome = _update_bounds(j, new_low, new_high, lower, upper)
        if outcome < 0:
            return -1
        progress = max(progress, outcome)
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
def _is_excluded(rows: SparseRows, r: int, lower: Array, upper: Array) -> bool:
    """Return whether row r cannot hold within the box."""
    minimum, maximum = compute_interval(
        rows.pointer[r], rows.pointer[r + 1], rows.columns, rows.data, lower, upper
    )
    size = 1.0
    if not np.isinf(minimum):
        size = max(size, abs(minimum))
    if not np.isinf(maximum):
        size = max(size, abs(maximum))
    return minimum > rows.upper[r] + _CROSSED * size or maximum < rows.lower[r] - _CROSSED * size


@compiled
def propagate_bounds(
    plain: SparseRows,
    conditional: SparseRows,
    indicator: IntArray,
    value: IntArray,
    integer: BoolArray,
    lower: Array,
    upper: Array,
    max_rounds: int,
) -> bool:
    """Tighten bounds of variables in place; return False if nothing is feasible.

    Args:
        plain: Rows that always hold.
        conditional: Indicator rows, each of which holds where its binary has its value.
        indicator: Binary of each indicator row.
        value: Its value, 0 or 1.
        integer: (n,) mask of integers.
        lower: (n,) lower bounds, tightened.
        upper: (n,) upper bounds, tightened.
        max_rounds: Largest number of passes over all rows.
    """
    for _ in range(max_rounds):
        has_progress = False
        for r in range(len(plain.lower)):
            outcome = _tighten_row(plain, r, lower, upper, integer)
            if outcome < 0:
                return False
            has_progress = has_progress or outcome > 0
        for r in range(len(conditional.lower)):
            b = indicator[r]
            if lower[b] < upper[b]:
                if _is_excluded(conditional, r, lower, upper):
                    lower[b] = upper[b] = 1.0 - value[r]
                    has_progress = True
            elif lower[b] == value[r]:
                outcome = _tighten_row(conditional, r, lower, upper, integer)
                if outcome < 0:
                    return False
                has_progress = has_progress or outcome > 0
        if not has_progress:
            break
    return True
