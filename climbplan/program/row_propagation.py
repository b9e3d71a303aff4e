"""Interval propagation over linear rows: each row bounds each of its variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.arrays import Array

_PROGRESS = 1e-3  # a round that moves no bound by more than this share is the last
_WEAK = 1e-7  # entries below this share of a row's largest bound no variable
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Range:
    """lower <= value <= upper, elementwise."""

    lower: Array
    upper: Array

    def moved_to(self, other: Range) -> bool:
        """Whether the bounds of `other` are closer by a share that is worth another round."""
        opened = np.isinf(self.lower) & np.isfinite(other.lower)
        opened |= np.isinf(self.upper) & np.isfinite(other.upper)
        with np.errstate(invalid="ignore"):
            closer = np.maximum(other.lower - self.lower, self.upper - other.upper)
        width = np.maximum(other.upper - other.lower, _ROUNDING)
        return bool((opened | (np.nan_to_num(closer, nan=0.0) > _PROGRESS * width)).any())


class RowPropagation:
    """row_lower <= rows x <= row_upper, ready for many rounds."""

    def __init__(self, rows: sparse.csr_matrix, row_lower: Array, row_upper: Array) -> None:
        rows.eliminate_zeros()
        entry = rows.tocoo()
        self._row, self._column, self._value = entry.row, entry.col, entry.data
        self._count = rows.shape[0]
        self._lower, self._upper = row_lower[entry.row], row_upper[entry.row]
        largest = np.zeros(self._count)
        np.maximum.at(largest, entry.row, np.abs(entry.data))
        # Division by a weak entry would only amplify rounding.
        self._strong = np.abs(entry.data) > _WEAK * largest[entry.row]

    def tightened(self, bounds: Range) -> Range:
        """Every variable bounded by every row, given the bounds of the row's other variables."""
        i, j, a, strong = self._row, self._column, self._value, self._strong
        low, high = bounds.lower, bounds.upper
        # A row's parts without an entry's own bound what is left for the entry.
        rest_low = _rest(np.where(a > 0, a * low[j], a * high[j]), i, self._count)
        rest_high = _rest(np.where(a > 0, a * high[j], a * low[j]), i, self._count)
        one, other = (self._lower - rest_high) / a, (self._upper - rest_low) / a
        new_low, new_high = low.copy(), high.copy()
        np.maximum.at(new_low, j[strong], np.minimum(one, other)[strong] - _ROUNDING)
        np.minimum.at(new_high, j[strong], np.maximum(one, other)[strong] + _ROUNDING)
        return Range(new_low, new_high)


def _rest(part: Array, row: NDArray[np.intp], count: int) -> Array:
    """Sum of a row's parts without each entry's own; infinite if another part is."""
    infinite = np.isinf(part)
    total = np.bincount(row, np.where(infinite, 0.0, part), count)[row]
    others = np.bincount(row, infinite, count)[row] - infinite
    sign = np.sign(np.bincount(row, np.where(infinite, np.sign(part), 0.0), count)[row])
    rest = total - np.where(infinite, 0.0, part)
    return np.where(others > 0, np.where(sign < 0, -np.inf, np.inf), rest)
