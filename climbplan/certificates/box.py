"""Boxes of v, and bound tightening by outward-rounded interval arithmetic.

Rows may be violated by `TOLERANCE`. An indicator row that cannot hold anywhere in the box fixes its
binary to the other value (feasibility-based bound tightening, Belotti et al. 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.certificates.rounding import bound_error, round_down, round_up
from climbplan.certificates.rows import CertificateRows

TOLERANCE = 1e-10
_PROGRESS = 1e-6  # relative change of bounds below which sweeps stop


@dataclass(frozen=True)
class CertificateBox:
    """The box lower <= v <= upper, empty if bounds cross."""

    lower: Array  # (N,)
    upper: Array

    @property
    def empty(self) -> bool:
        """Return whether bounds cross."""
        return bool((self.lower > self.upper).any())

    def classify_rows(self, rows: CertificateRows) -> tuple[BoolArray, BoolArray]:
        """Return masks of rows that are active, and of rows whose binary is still open."""
        b, low, high = rows.binary, self.lower[rows.binary], self.upper[rows.binary]
        is_fixed = (low == rows.value) & (high == rows.value)
        return (b < 0) | is_fixed, (b >= 0) & rows.integer[b] & (low == 0.0) & (high == 1.0)

    def bisect(
        self, rows: CertificateRows, j: int, value: float
    ) -> tuple[CertificateBox, CertificateBox]:
        """Return both sides of a split, which together cover every v of the box."""
        below, above = self.upper.copy(), self.lower.copy()
        below[j] = min(below[j], np.floor(value) if rows.integer[j] else value)
        above[j] = max(above[j], np.floor(value) + 1.0 if rows.integer[j] else value)
        return CertificateBox(self.lower, below), CertificateBox(above, self.upper)


def tighten_box(rows: CertificateRows, box: CertificateBox, sweeps: int = 8) -> CertificateBox:
    """Return a smaller box with the same feasible points, by sweeps over products and rows."""
    for _ in range(sweeps):
        previous, box = box, CertificateBox(box.lower.copy(), box.upper.copy())
        _tighten_by_products(rows, box)
        _tighten_by_rows(rows, box)
        box.lower[rows.integer] = np.ceil(box.lower[rows.integer])
        box.upper[rows.integer] = np.floor(box.upper[rows.integer])
        ends = np.append(previous.lower, previous.upper), np.append(box.lower, box.upper)
        if box.empty or np.isclose(*ends, _PROGRESS, _PROGRESS).all():
            break
    return box


def _tighten_by_products(rows: CertificateRows, box: CertificateBox) -> None:
    """Tighten products by the ranges of their factors, and factors by roots of squares."""
    i, j, w = rows.first, rows.second, rows.w
    x, y = np.stack([box.lower[i], box.upper[i]]), np.stack([box.lower[j], box.upper[j]])
    with np.errstate(invalid="ignore"):
        ends = (x[:, None] * y[None]).reshape(4, -1)
        positive = np.where(x[0] * x[1] > 0.0, (x**2).min(axis=0), 0.0)
    ends[np.isnan(ends)] = 0.0  # zero times an open end
    minimum = np.where(i == j, positive, ends.min(axis=0))
    box.lower[w] = np.maximum(box.lower[w], round_down(minimum))
    box.upper[w] = np.minimum(box.upper[w], round_up(ends.max(axis=0)))
    root = round_up(np.sqrt(np.maximum(box.upper[w[i == j]], 0.0)))
    np.minimum.at(box.upper, i[i == j], root)
    np.maximum.at(box.lower, i[i == j], -root)


def _tighten_by_rows(rows: CertificateRows, box: CertificateBox) -> None:
    """Tighten every variable of a row by the row's bounds and its other variables."""
    index, data, binary = rows.G.indices, rows.G.data, rows.binary
    row = np.repeat(np.arange(len(binary)), np.diff(rows.G.indptr))
    low, high = round_down(rows.lower - TOLERANCE), round_up(rows.upper + TOLERANCE)
    ends = data * np.stack([box.lower, box.upper])[:, index]
    min_activity, min_others = _sum_rows(row, ends.min(axis=0), len(binary))
    max_activity, max_others = _sum_rows(row, -ends.max(axis=0), len(binary))

    is_violated = (min_activity > high) | (-max_activity < low)
    is_active, is_open = box.classify_rows(rows)
    fixes_binary = is_violated & is_open
    np.maximum.at(box.lower, binary[fixes_binary], 1.0 - rows.value[fixes_binary])
    np.minimum.at(box.upper, binary[fixes_binary], 1.0 - rows.value[fixes_binary])
    if (is_violated & is_active).any():
        box.upper[:] = -np.inf

    entries = is_active[row]
    implied_bounds = (
        np.stack([round_down(low[row] + max_others), round_up(high[row] - min_others)])[:, entries]
        / data[entries]
    )
    np.maximum.at(
        box.lower, index[entries], round_down(np.where(data[entries] > 0, *implied_bounds))
    )
    np.minimum.at(box.upper, index[entries], round_up(np.where(data[entries] < 0, *implied_bounds)))


def _sum_rows(row: IntArray, value: Array, rows: int) -> tuple[Array, Array]:
    """Return the sum of each row, and for each entry the sum of the others, rounded down."""
    infinite = np.isinf(value)
    finite = np.where(infinite, 0.0, value)
    num_infinite = np.bincount(row, infinite, rows)
    total = np.bincount(row, finite, rows)
    size, count = np.bincount(row, np.abs(finite), rows), np.bincount(row, minlength=rows)
    error = bound_error(count.astype(float) + 1.0, size.astype(float))
    other_sums = np.where(num_infinite[row] > infinite, -np.inf, total[row] - finite - error[row])
    return np.where(num_infinite > 0, -np.inf, total - error), other_sums
