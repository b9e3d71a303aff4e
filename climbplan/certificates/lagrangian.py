"""What a leaf's multipliers prove: the least value of its Lagrangian over its box of v = (x, z, w).

For multipliers l of rows G v >= g (and those of upper sides, which are negative)

    1/2 x'Px + q'x + c  >=  c - 1/2 p'Pp + l'g + (q + Pp)'x - l'G v - 1/2 s |x - p|^2

for every feasible v, where p is any point and P + s I is positive semidefinite. A row that holds
only where a binary z is 1 is G v >= g - M (1 - z), with M what it can fail by in the box. A ball
|F x + f| <= r has b'(F x + f) <= |b| r for every b. Without the cost, a value of more than 0
proves that the leaf has no point.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import Box
from climbplan.certificates.rounding import down, off_by, up
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Instance

_LIFT = 1e-13  # of the largest entry: makes a Cholesky factor of a singular matrix


class Lagrangian:
    """slope'(v, 1) as a sum of entries, with their sizes, which rounding is a share of."""

    def __init__(self, size: int) -> None:
        """Nothing, of v of some size."""
        self.slope, self.size = np.zeros(size + 1), np.zeros(size + 1)
        self.terms = 8  # more than any entry is a product of
        self.weight = 0.0  # by which it is less at points that are 1 outside of rows and balls

    def add(self, entries: Array, places: IntArray | int = -1) -> None:
        """Add entries to slopes, several perhaps to one; to the constant if left out."""
        places = np.full(entries.shape, places) if isinstance(places, int) else places
        np.add.at(self.slope, places, entries)
        np.add.at(self.size, places, np.abs(entries))
        self.terms += entries.size

    def least(self, box: Box) -> float:
        """The least value over a box, rounded down."""
        here = self.size > 0.0
        slope, size = self.slope[here], self.size[here]
        ends = np.stack([np.append(box.lower, 1.0)[here], np.append(box.upper, 1.0)[here]])
        if not (np.isfinite(slope).all() and np.isfinite(ends).all()):
            return -np.inf
        off = off_by(self.terms, size) * np.abs(ends).max(axis=0)
        values = (slope * ends).min(axis=0) - off
        return float(down(values.sum() - off_by(self.terms, np.abs(values).sum())))


def lagrangian(
    instance: Instance, rows: StatedRows, box: Box, point: Array | None, y: Array, ball: Array
) -> Lagrangian:
    """Of multipliers y of rows and `ball` of balls; without a point, without the cost."""
    total = Lagrangian(len(rows.integer))
    if point is not None:
        P = sparse.coo_matrix(instance.P)
        total.add(np.array([instance.constant]))
        total.add(-0.5 * point[P.row] * P.data * point[P.col])
        total.add(instance.q, np.arange(instance.size))
        total.add(0.5 * P.data * point[P.col], P.row)  # twice the same if P is symmetric
        total.add(0.5 * P.data * point[P.row], P.col)
    _add_rows(total, rows, box, y)
    at = 0
    for balls in instance.balls:  # b'(F x + f) - |b| r
        b, F = ball[at : at + balls.f.size], sparse.coo_matrix(balls.F)
        at += balls.f.size
        length = np.linalg.norm(b.reshape(balls.f.shape), axis=1)
        total.add(b * balls.f.ravel())
        total.add(-length * balls.radius)
        total.add(b[F.row] * F.data, F.col)
        total.weight += float(length.sum())
    return total


def _add_rows(total: Lagrangian, rows: StatedRows, box: Box, y: Array) -> None:
    """l'g - l'G v, and - M (1 - z) of rows that hold where z is 1, - M z where it is 0."""
    holds, maybe = box.holding(rows)
    r = np.flatnonzero((y != 0.0) & (holds | maybe))  # others say nothing in this box
    y, b, sign, maybe, one = y[r], rows.binary[r], np.sign(y[r]), maybe[r], rows.value[r] == 1
    side, G = np.where(y > 0.0, rows.lower[r], rows.upper[r]), rows.G[r]
    at = np.repeat(np.arange(len(r)), np.diff(G.indptr))
    least = (sign[at] * G.data * np.stack([box.lower, box.upper])[:, G.indices]).min(axis=0)
    error = off_by(len(least), np.bincount(at, np.abs(least), len(r)).astype(float))
    with np.errstate(invalid="ignore"):  # a side that is not there, which proves nothing
        fails = up(up(sign * side - np.bincount(at, least, len(r))) + error)
        lost = np.where(maybe, np.abs(y) * np.maximum(fails, 0.0), 0.0)
        total.add(y * side)
        total.add(-lost[one])
        total.add(np.where(one, lost, -lost)[maybe], b[maybe])
        total.add(-y[at] * G.data, G.indices)
    total.weight += float(np.abs(y).sum())


def curvature(P: sparse.csc_matrix) -> Array:
    """(n,) by which the diagonal is lifted so that P is surely positive semidefinite."""
    shift = np.maximum(-P.diagonal(), 0.0)
    count, label = connected_components(P, directed=False)
    for k in np.flatnonzero(np.bincount(label, minlength=count) > 1):
        here = np.flatnonzero(label == k)
        block = P[here][:, here].toarray()
        m, top = len(here), float(np.abs(block).max())
        lifted = block + _LIFT * m * top * np.eye(m)
        try:
            L = np.linalg.cholesky(lifted)
        except np.linalg.LinAlgError:
            shift[here] = m * top  # more than any eigenvalue
            continue
        error = np.abs(lifted - L @ L.T) + off_by(m + 2, np.abs(L) @ np.abs(L).T + np.abs(lifted))
        shift[here] = up(_LIFT * m * top + 1.01 * np.maximum(error, error.T).sum(axis=1).max())
    return shift
