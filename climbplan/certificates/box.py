"""The box that bounds and rows leave, by interval arithmetic that is rounded outwards.

Rows may be violated by the tolerance. A row that some integer's value or some alternative asks for
and that cannot hold within the box excludes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.certificates.rounding import down, off_by, up
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array

_SWEEPS = 60


@dataclass
class Box:
    """lower <= x <= upper and the alternatives that are left; `empty` if no point is."""

    lower: Array  # (n,)
    upper: Array
    allowed: NDArray[np.bool_]  # (R,)
    integer: NDArray[np.bool_]  # (n,)
    empty: bool = False

    def within(self, lower: Array, upper: Array) -> NDArray[np.bool_]:
        """(n,) which sides lie inside another box."""
        return np.asarray((self.lower >= lower) & (self.upper <= upper))

    def narrow(self, index: Index, low: Array, high: Array) -> bool:
        """Take in bounds of some variables; True if one moved."""
        whole = self.integer[index]
        low = np.where(whole, np.ceil(low), low)
        high = np.where(whole, np.floor(high), high)
        moved = (low > self.lower[index]) | (high < self.upper[index])
        self.lower[index] = np.maximum(self.lower[index], low)
        self.upper[index] = np.minimum(self.upper[index], high)
        self.empty = self.empty or bool((self.lower[index] > self.upper[index]).any())
        return bool(moved.any())


def implied_box(
    instance: Instance, rows: StatedRows, lower: Array, upper: Array, tolerance: float
) -> Box:
    """Sweep over all rows until the box lies within the one given, or nothing moves."""
    box = Box(
        instance.lower.astype(float),
        instance.upper.astype(float),
        np.ones(len(rows.choice), bool),
        instance.integer,
    )
    whole = np.flatnonzero(instance.integer)
    box.narrow(whole, box.lower[whole], box.upper[whole])
    for _ in range(_SWEEPS):
        if box.empty or box.within(lower, upper).all():
            break
        moved = _ball_sweep(instance, box, tolerance)
        for r in range(rows.count):
            moved = _look(rows, r, box, tolerance) or moved
            if box.empty:
                return box
        if not moved:
            break
    return box


def _look(rows: StatedRows, r: int, box: Box, tolerance: float) -> bool:
    """What one row says of the box, or of what it depends on."""
    begin, end = rows.G.indptr[r], rows.G.indptr[r + 1]
    index, data = rows.G.indices[begin:end], rows.G.data[begin:end]
    low, high = rows.lower[r] - tolerance, rows.upper[r] + tolerance
    b, a = rows.binary[r], rows.alternative[r]
    if b >= 0:
        value = rows.value[r]
        if not box.lower[b] <= value <= box.upper[b]:
            return False
        if box.lower[b] < box.upper[b]:
            if _possible(data, index, low, high, box):
                return False
            other = np.array([1.0 - value])
            return box.narrow(np.array([b]), other, other)
    if a >= 0:
        if not box.allowed[a]:
            return False
        if (box.allowed & (rows.choice == rows.choice[a])).sum() > 1:
            if _possible(data, index, low, high, box):
                return False
            box.allowed[a] = False
            return True
    return _narrowed(data, index, low, high, box)


def _parts(data: Array, index: Index, box: Box) -> tuple[Array, Array]:
    """Least and largest value of each entry's product."""
    one, other = data * box.lower[index], data * box.upper[index]
    return np.minimum(one, other), np.maximum(one, other)


def _possible(data: Array, index: Index, low: float, high: float, box: Box) -> bool:
    """Whether a row may hold somewhere in the box."""
    least, most = _parts(data, index, box)
    below, above = float(least.sum()), float(most.sum())
    if np.isfinite(below) and below - off_by(len(data), np.abs(least).sum()) > up(high):
        return False
    return not (np.isfinite(above) and above + off_by(len(data), np.abs(most).sum()) < down(low))


def _narrowed(data: Array, index: Index, low: float, high: float, box: Box) -> bool:
    """Bounds of a row's variables from those of the others; True if one moved."""
    if not _possible(data, index, low, high, box):
        box.empty = True
        return False
    least, most = _parts(data, index, box)
    above = _without_each(least)  # the others are worth at least this
    below = -_without_each(-most)
    with np.errstate(invalid="ignore", over="ignore"):
        room_high, room_low = up(high - above) / data, down(low - below) / data
    positive = data > 0
    new_low = np.where(positive, room_low, room_high)
    new_high = np.where(positive, room_high, room_low)
    new_low = np.where(np.isnan(new_low), -np.inf, down(down(new_low)))
    new_high = np.where(np.isnan(new_high), np.inf, up(up(new_high)))
    return box.narrow(index, new_low, new_high)


def _without_each(parts: Array) -> Array:
    """Sum of all parts but each one, rounded down; minus infinity where another is."""
    finite = np.isfinite(parts)
    total = float(parts[finite].sum())
    rest = total - np.where(finite, parts, 0.0)
    rest = rest - off_by(len(parts) + 1, np.abs(parts[finite]).sum())
    others = (~finite).sum() - ~finite
    return np.where(others > 0, -np.inf, rest)


def _ball_sweep(instance: Instance, box: Box, tolerance: float) -> bool:
    """Every coordinate of a ball lies within its radius."""
    moved = False
    for balls in instance.balls:
        F = sparse.csr_matrix(balls.F)
        radius = np.repeat(balls.radius, balls.f.shape[1]) + tolerance
        for r, (shift, reach) in enumerate(zip(balls.f.ravel(), radius, strict=True)):
            here = slice(F.indptr[r], F.indptr[r + 1])
            index, data = F.indices[here], F.data[here]
            if len(data):
                low, high = float(down(-reach - shift)), float(up(reach - shift))
                moved = _narrowed(data, index, low, high, box) or moved
    return moved
