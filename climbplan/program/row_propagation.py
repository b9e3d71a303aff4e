"""Interval propagation over linear rows: each row bounds each of its variables (FBBT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.arrays import Array

_PROGRESS = 1e-3  # a round that moves no bound by more than this fraction is the last
_WEAK = 1e-7  # entries below this fraction of a row's largest entry bound no variable
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ElementwiseRange:
    """Elementwise range lower <= value <= upper."""

    lower: Array
    upper: Array

    def has_progressed(self, tightened: ElementwiseRange) -> bool:
        """Return whether the bounds of `other` are tighter by enough for another round."""
        is_bounded_now = np.isinf(self.lower) & np.isfinite(tightened.lower)
        is_bounded_now |= np.isinf(self.upper) & np.isfinite(tightened.upper)
        with np.errstate(invalid="ignore"):
            closer = np.maximum(tightened.lower - self.lower, self.upper - tightened.upper)
        width = np.maximum(tightened.upper - tightened.lower, _ROUNDING)
        return bool((is_bounded_now | (np.nan_to_num(closer, nan=0.0) > _PROGRESS * width)).any())


class RowPropagation:
    """Rows row_lower <= rows x <= row_upper, prepared for many rounds."""

    def __init__(self, rows: sparse.csr_matrix, row_lower: Array, row_upper: Array) -> None:
        """Prepare entries."""
        rows.eliminate_zeros()
        entry = rows.tocoo()
        self._row, self._column, self._value = entry.row, entry.col, entry.data
        self._count = rows.shape[0]
        self._lower, self._upper = row_lower[entry.row], row_upper[entry.row]
        largest = np.zeros(self._count)
        np.maximum.at(largest, entry.row, np.abs(entry.data))
        # Division by a weak entry would only amplify rounding errors
        self._strong = np.abs(entry.data) > _WEAK * largest[entry.row]

    def tighten(self, bounds: ElementwiseRange) -> ElementwiseRange:
        """Tighten every variable by every row, given the bounds of the row's other variables."""
        i, j, a, strong = self._row, self._column, self._value, self._strong
        low, high = bounds.lower, bounds.upper
        # The activity of a row's other entries bounds each entry
        rest_min = _sum_others(np.where(a > 0, a * low[j], a * high[j]), i, self._count)
        rest_max = _sum_others(np.where(a > 0, a * high[j], a * low[j]), i, self._count)
        first_end, second_end = (self._lower - rest_max) / a, (self._upper - rest_min) / a
        new_low, new_high = low.copy(), high.copy()
        np.maximum.at(new_low, j[strong], np.minimum(first_end, second_end)[strong] - _ROUNDING)
        np.minimum.at(new_high, j[strong], np.maximum(first_end, second_end)[strong] + _ROUNDING)
        return ElementwiseRange(new_low, new_high)


def _sum_others(value: Array, row: NDArray[np.intp], count: int) -> Array:
    """Return the sum of a row's other entries for each entry; infinite if another one is."""
    infinite = np.isinf(value)
    total = np.bincount(row, np.where(infinite, 0.0, value), count)[row]
    num_infinite = np.bincount(row, infinite, count)[row] - infinite
    sign = np.sign(np.bincount(row, np.where(infinite, np.sign(value), 0.0), count)[row])
    other_sum = total - np.where(infinite, 0.0, value)
    return np.where(num_infinite > 0, np.where(sign < 0, -np.inf, np.inf), other_sum)
