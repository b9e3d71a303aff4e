"""Boxes of v, and what rows and products leave of them, by interval arithmetic rounded outwards.

Rows may be violated by `TOLERANCE`. A row that holds only for one value of a binary, and that
cannot hold anywhere in the box, leaves the other value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.certificates.rounding import down, off_by, up
from climbplan.certificates.rows import StatedRows

TOLERANCE = 1e-10
_MOVED = 1e-6  # a smaller move, relative, is no reason for another sweep


@dataclass(frozen=True)
class Box:
    """lower <= v <= upper, where no v is if they cross somewhere."""

    lower: Array  # (N,)
    upper: Array

    @property
    def empty(self) -> bool:
        """Whether bounds cross."""
        return bool((self.lower > self.upper).any())

    def holding(self, rows: StatedRows) -> tuple[BoolArray, BoolArray]:
        """Which rows have to hold, and which may have to: their binary can be 0 and 1."""
        b, low, high = rows.binary, self.lower[rows.binary], self.upper[rows.binary]
        has = (low == rows.value) & (high == rows.value)
        return (b < 0) | has, (b >= 0) & rows.integer[b] & (low == 0.0) & (high == 1.0)

    def halves(self, rows: StatedRows, j: int, at: float) -> tuple[Box, Box]:
        """Both sides of a split: together they hold every v of the box."""
        below, above = self.upper.copy(), self.lower.copy()
        below[j] = min(below[j], np.floor(at) if rows.integer[j] else at)
        above[j] = max(above[j], np.floor(at) + 1.0 if rows.integer[j] else at)
        return Box(self.lower, below), Box(above, self.upper)


def narrowed(rows: StatedRows, box: Box, sweeps: int = 8) -> Box:
    """A smaller box with the same feasible points, by sweeps over all products and rows."""
    for _ in range(sweeps):
        last, box = box, Box(box.lower.copy(), box.upper.copy())
        _by_products(rows, box)
        _by_rows(rows, box)
        box.lower[rows.integer] = np.ceil(box.lower[rows.integer])
        box.upper[rows.integer] = np.floor(box.upper[rows.integer])
        ends = np.append(last.lower, last.upper), np.append(box.lower, box.upper)
        if box.empty or np.isclose(*ends, _MOVED, _MOVED).all():
            break
    return box


def _by_products(rows: StatedRows, box: Box) -> None:
    """w within the products of what its factors may be, and factors within roots of squares."""
    i, j, w = rows.first, rows.second, rows.w
    x, y = np.stack([box.lower[i], box.upper[i]]), np.stack([box.lower[j], box.upper[j]])
    with np.errstate(invalid="ignore"):
        ends = (x[:, None] * y[None]).reshape(4, -1)
        positive = np.where(x[0] * x[1] > 0.0, (x**2).min(axis=0), 0.0)
    ends[np.isnan(ends)] = 0.0  # zero times an open end
    least = np.where(i == j, positive, ends.min(axis=0))
    box.lower[w] = np.maximum(box.lower[w], down(least))
    box.upper[w] = np.minimum(box.upper[w], up(ends.max(axis=0)))
    root = up(np.sqrt(np.maximum(box.upper[w[i == j]], 0.0)))
    np.minimum.at(box.upper, i[i == j], root)
    np.maximum.at(box.lower, i[i == j], -root)


def _by_rows(rows: StatedRows, box: Box) -> None:
    """Every variable of a row within what the row's bounds and its other variables leave it."""
    index, data, binary = rows.G.indices, rows.G.data, rows.binary
    row = np.repeat(np.arange(len(binary)), np.diff(rows.G.indptr))
    low, high = down(rows.lower - TOLERANCE), up(rows.upper + TOLERANCE)
    ends = data * np.stack([box.lower, box.upper])[:, index]
    least, least_others = _sums(row, ends.min(axis=0), len(binary))
    most, most_others = _sums(row, -ends.max(axis=0), len(binary))

    impossible = (least > high) | (-most < low)
    holds, maybe = box.holding(rows)
    out = impossible & maybe
    np.maximum.at(box.lower, binary[out], 1.0 - rows.value[out])
    np.minimum.at(box.upper, binary[out], 1.0 - rows.value[out])
    if (impossible & holds).any():
        box.upper[:] = -np.inf

    here = holds[row]
    room = (
        np.stack([down(low[row] + most_others), up(high[row] - least_others)])[:, here] / data[here]
    )
    np.maximum.at(box.lower, index[here], down(np.where(data[here] > 0, *room)))
    np.minimum.at(box.upper, index[here], up(np.where(data[here] < 0, *room)))


def _sums(row: IntArray, part: Array, rows: int) -> tuple[Array, Array]:
    """Sum of the parts of each row, and for each part that of the others, both rounded down."""
    infinite = np.isinf(part)
    finite = np.where(infinite, 0.0, part)
    opens = np.bincount(row, infinite, rows)
    total = np.bincount(row, finite, rows)
    size, count = np.bincount(row, np.abs(finite), rows), np.bincount(row, minlength=rows)
    error = off_by(count.astype(float) + 1.0, size.astype(float))
    others = np.where(opens[row] > infinite, -np.inf, total[row] - finite - error[row])
    return np.where(opens > 0, -np.inf, total - error), others
