"""Minimise the Lagrangian of a leaf's multipliers over its box of v = (x, z, w).

For multipliers l of rows G v >= g (and those of upper sides, which are negative)

    1/2 x'Px + q'x + c  >=  c - 1/2 p'Pp + l'g + (q + Pp)'x - l'G v - 1/2 s |x - p|^2

for every feasible v, where p is any point and P + s I is positive semidefinite. A row that holds
only where a binary z is 1 is G v >= g - M (1 - z), with its largest violation M in the box. A ball
|F x + f| <= r has b'(F x + f) <= |b| r for every b. Without the cost, a positive value proves that
the leaf has no point.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.arrays import Array, IntArray
from climbplan.certificates.box import CertificateBox
from climbplan.certificates.rounding import bound_error, round_down, round_up
from climbplan.certificates.rows import CertificateRows
from climbplan.program.instance import Instance

_LIFT = 1e-13  # diagonal shift for the Cholesky factor of a singular matrix, relative


class Lagrangian:
    """The function slope'(v, 1) as a sum of entries, with the sizes that bound rounding."""

    def __init__(self, size: int) -> None:
        """Begin with zero over v of some size."""
        self.slope, self.size = np.zeros(size + 1), np.zeros(size + 1)
        self.terms = 8  # more than the number of factors of any entry
        self.weight = 0.0  # decrease at points that violate rows and balls by 1

    def add(self, entries: Array, places: IntArray | int = -1) -> None:
        """Add entries to slopes, possibly several to one; to the constant by default."""
        places = np.full(entries.shape, places) if isinstance(places, int) else places
        np.add.at(self.slope, places, entries)
        np.add.at(self.size, places, np.abs(entries))
        self.terms += entries.size

    def minimise(self, box: CertificateBox) -> float:
        """Return the minimum over a box, rounded down; a slope of certain sign needs one bound."""
        is_used = self.size > 0.0
        slope, size = self.slope[is_used], self.size[is_used]
        lower, upper = np.append(box.lower, 1.0)[is_used], np.append(box.upper, 1.0)[is_used]
        error = bound_error(self.terms, size)
        first = np.where((slope < -error) & np.isinf(lower), upper, lower)
        ends = np.stack([first, np.where((slope > error) & np.isinf(upper), lower, upper)])
        if not (np.isfinite(slope).all() and np.isfinite(ends).all()):
            return -np.inf
        error = error * np.abs(ends).max(axis=0)
        values = (slope * ends).min(axis=0) - error
        return float(round_down(values.sum() - bound_error(self.terms, np.abs(values).sum())))


def build_lagrangian(
    instance: Instance,
    rows: CertificateRows,
    box: CertificateBox,
    point: Array | None,
    y: Array,
    ball: Array,
) -> Lagrangian:
    """Build the Lagrangian of multipliers y and `ball`; without a point the cost is left out."""
    total = Lagrangian(len(rows.integer))
    if point is not None:
        P = sparse.coo_matrix(instance.P)
        total.add(np.array([instance.constant]))
        total.add(-0.5 * point[P.row] * P.data * point[P.col])
        total.add(instance.q, np.arange(instance.size))
        total.add(0.5 * P.data * point[P.col], P.row)  # twice the same if P is symmetric
        total.add(0.5 * P.data * point[P.row], P.col)
    _add_rows(total, rows, box, y)
    begin = 0
    for balls in instance.balls:  # b'(F x + f) - |b| (radius + slope x)
        b, F = ball[begin : begin + balls.f.size], sparse.coo_matrix(balls.F)
        begin += balls.f.size
        length = np.linalg.norm(b.reshape(balls.f.shape), axis=1)
        total.add(b * balls.f.ravel())
        total.add(-length * balls.radius)
        total.add(b[F.row] * F.data, F.col)
        if balls.slope is not None:
            G = sparse.coo_matrix(balls.slope)
            total.add(-length[G.row] * G.data, G.col)
        total.weight += float(length.sum())
    return total


def _add_rows(total: Lagrangian, rows: CertificateRows, box: CertificateBox, y: Array) -> None:
    """Add l'g - l'G v, and - M (1 - z) of rows that hold where z is 1, - M z where it is 0."""
    is_active, is_open = box.classify_rows(rows)
    r = np.flatnonzero((y != 0.0) & (is_active | is_open))  # others are inactive in this box
    y, b, sign = y[r], rows.binary[r], np.sign(y[r])
    is_open, is_one = is_open[r], rows.value[r] == 1
    side, G = np.where(y > 0.0, rows.lower[r], rows.upper[r]), rows.G[r]
    row = np.repeat(np.arange(len(r)), np.diff(G.indptr))
    low = (sign[row] * G.data * np.stack([box.lower, box.upper])[:, G.indices]).min(axis=0)
    error = bound_error(len(low), np.bincount(row, np.abs(low), len(r)).astype(float))
    with np.errstate(invalid="ignore"):  # a missing side, which proves nothing
        big_m = round_up(round_up(sign * side - np.bincount(row, low, len(r))) + error)
        loss = np.where(is_open, np.abs(y) * np.maximum(big_m, 0.0), 0.0)
        total.add(y * side)
        total.add(-loss[is_one])
        total.add(np.where(is_one, loss, -loss)[is_open], b[is_open])
        total.add(-y[row] * G.data, G.indices)
    total.weight += float(np.abs(y).sum())


def compute_convexity_shift(P: sparse.csc_matrix) -> Array:
    """Return the shift (n,) of the diagonal that makes P certainly positive semidefinite."""
    shift = np.maximum(-P.diagonal(), 0.0)
    count, label = connected_components(P, directed=False)
    for k in np.flatnonzero(np.bincount(label, minlength=count) > 1):
        index = np.flatnonzero(label == k)
        block = P[index][:, index].toarray()
        m, top = len(index), float(np.abs(block).max())
        lifted = block + _LIFT * m * top * np.eye(m)
        try:
            L = np.linalg.cholesky(lifted)
        except np.linalg.LinAlgError:
            shift[index] = m * top  # more than any eigenvalue
            continue
        size = np.abs(L) @ np.abs(L).T + np.abs(lifted)
        error = np.abs(lifted - L @ L.T) + bound_error(m + 2, size)
        norm = np.maximum(error, error.T).sum(axis=1).max()
        shift[index] = round_up(_LIFT * m * top + 1.01 * norm)
    return shift
