"""What a leaf's multipliers prove: the least value of its Lagrangian over its box.

For multipliers l of rows G x >= g (and those of upper sides, which are negative)

    1/2 x'Px + q'x + c  >=  c - 1/2 p'Pp + l'g + (q + Pp - G'l)'x - 1/2 s |x - p|^2

for every feasible x, where p is any point and P + s I is positive semidefinite. A row that holds
only where a binary z is 1 is G x >= g - M (1 - z), with M what it can fail by in the box; of rows
of alternatives all those fail whose alternative is not the one that is chosen. A ball
|F x + f| <= r has b'(F x + f) <= |b| r for every b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from climbplan.certificates.certificate import Certificate
from climbplan.certificates.rounding import down, off_by, up
from climbplan.certificates.rows import StatedRows
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array

_CHUNK = 512  # leaves at once
_LIFT = 1e-13  # of the largest entry: makes a Cholesky factor of a singular matrix


class Proved(NamedTuple):
    """What leaves prove."""

    bound: Array  # (S,) of the cost; infinite for a leaf without a point
    margin: Array  # (S,) by how much all rows can be let out and the leaf is still empty


@dataclass(frozen=True)
class _Numbers:
    """What does not depend on the leaf."""

    instance: Instance
    rows: StatedRows
    lower: Array
    upper: Array
    shift: Array  # (n,) s of each variable's block of P
    fails: tuple[Array, Array]  # (rows,) M of the lower and of the upper side
    tolerance: float


def proved(
    instance: Instance, rows: StatedRows, certificate: Certificate, tolerance: float
) -> Proved:
    """Bounds of all leaves, for points that may violate rows and balls by the tolerance."""
    lower, upper = certificate.lower, certificate.upper
    numbers = _Numbers(
        instance, rows, lower, upper, _curvature(instance.P), _fails(rows, lower, upper), tolerance
    )
    parts = [
        _chunk(numbers, certificate, slice(at, at + _CHUNK))
        for at in range(0, certificate.count, _CHUNK)
    ]
    if not parts:
        return Proved(np.zeros(0), np.zeros(0))
    return Proved(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _fails(rows: StatedRows, lower: Array, upper: Array) -> tuple[Array, Array]:
    """By how much each side of each row can fail in the box, (rows,) twice."""
    G = rows.G
    row = np.repeat(np.arange(rows.count), np.diff(G.indptr))

    def total(entries: Array) -> Array:
        return np.bincount(row, entries, rows.count).astype(float)

    one, other = G.data * lower[G.indices], G.data * upper[G.indices]
    with np.errstate(invalid="ignore"):
        least, most = total(np.minimum(one, other)), total(np.maximum(one, other))
        error = off_by(int(np.diff(G.indptr).max(initial=0)), total(np.abs(one) + np.abs(other)))
        under, over = up(rows.lower - least + error), up(most + error - rows.upper)
    return _excess(under), _excess(over)


def _excess(value: Array) -> Array:
    """Not negative; infinite where it is not known."""
    return np.maximum(np.where(np.isnan(value), np.inf, value), 0.0)


def _curvature(P: sparse.csc_matrix) -> Array:
    """(n,) by which the diagonal is lifted so that P is surely positive semidefinite."""
    n = P.shape[0]
    shift = np.zeros(n)
    count, label = connected_components(P, directed=False)
    size = np.bincount(label, minlength=count)
    diagonal = P.diagonal()
    alone = size[label] == 1
    shift[alone] = np.maximum(-diagonal[alone], 0.0)
    for k in np.flatnonzero(size > 1):
        here = np.flatnonzero(label == k)
        block = P[here][:, here].toarray()
        m, top = len(here), float(np.abs(block).max())
        lift = _LIFT * m * top
        try:
            L = np.linalg.cholesky(block + lift * np.eye(m))
        except np.linalg.LinAlgError:
            shift[here] = m * top  # more than any eigenvalue
            continue
        size_of = np.abs(L) @ np.abs(L).T + np.abs(block) + lift * np.eye(m)
        error = np.abs(block + lift * np.eye(m) - L @ L.T) + off_by(m + 2, size_of)
        shift[here] = up(lift + 1.01 * error.sum(axis=1).max())
    return shift


def _chunk(n: _Numbers, c: Certificate, here: slice) -> tuple[Array, Array]:
    """Bounds and margins of some leaves."""
    low, high = _leaf_boxes(n, c, here)
    cost, _ = _lagrangian(n, c, here, low, high, costs=True)
    feasible, weight = _lagrangian(n, c, here, low, high, costs=False)
    empty = c.empty[here] & (feasible > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        margin = np.where(empty, feasible / weight, 0.0)
    return np.where(empty, np.inf, np.where(c.empty[here], -np.inf, cost)), margin


def _leaf_boxes(n: _Numbers, c: Certificate, here: slice) -> tuple[Array, Array]:
    """The box with each leaf's integers, (S, n) twice."""
    count = len(c.low[here])
    low, high = np.tile(n.lower, (count, 1)), np.tile(n.upper, (count, 1))
    integers = np.flatnonzero(n.instance.integer)
    low[:, integers] = np.maximum(low[:, integers], c.low[here])
    high[:, integers] = np.minimum(high[:, integers], c.high[here])
    return low, high


@dataclass
class _Sum:
    """constant + slope'x of some leaves, with the sizes of what was added up."""

    constant: Array  # (S,)
    slope: Array  # (S, n)
    size: Array  # (S,)
    slope_size: Array  # (S, n)

    def add(self, constant: Array, size: Array) -> None:
        """Add to the constants."""
        self.constant = self.constant + constant
        self.size = self.size + size

    def add_slope(self, slope: Array, size: Array) -> None:
        """Add to the slopes."""
        self.slope = self.slope + slope
        self.slope_size = self.slope_size + size

    def least(self, low: Array, high: Array, terms: int) -> Array:
        """(S,) the least value over boxes (S, n), rounded down."""
        with np.errstate(invalid="ignore"):
            ends = np.minimum(self.slope * low, self.slope * high)
            ends = np.where(self.slope == 0.0, 0.0, ends)
            ends = ends - off_by(terms, self.slope_size) * np.maximum(np.abs(low), np.abs(high))
        ends = np.where(self.slope_size == 0.0, 0.0, ends)
        size = self.size + np.abs(ends).sum(axis=1)
        with np.errstate(invalid="ignore"):
            total = self.constant + ends.sum(axis=1) - off_by(terms, size)
        return np.where(np.isnan(total), -np.inf, total)


def _lagrangian(
    n: _Numbers, c: Certificate, here: slice, low: Array, high: Array, costs: bool
) -> tuple[Array, Array]:
    """Least value of the Lagrangian of each leaf, rounded down, and the sum of its multipliers.

    costs: with the cost, or of the rows alone, where more than 0 proves that the leaf is empty.
    """
    instance, rows, p = n.instance, n.rows, c.point[here]
    multiplier = c.multiplier[here].toarray()
    size = np.abs(multiplier)
    sides = np.where(multiplier > 0, rows.lower, rows.upper)
    missing = (np.isinf(sides) & (size > 0)).any(axis=1)  # a side that is not there
    edge = np.where(size > 0, np.where(np.isinf(sides), 0.0, sides), 0.0)
    total = _Sum(
        constant=np.where(missing, -np.inf, (multiplier * edge).sum(axis=1)),
        slope=-_times(multiplier, rows.G),
        size=(size * np.abs(edge)).sum(axis=1),
        slope_size=_times(size, abs(rows.G)),
    )
    if costs:
        P = sparse.csr_matrix(instance.P)
        Pp, Pp_size = _times(p, P), _times(np.abs(p), abs(P))
        total.add_slope(instance.q + Pp, np.abs(instance.q) + Pp_size)
        total.add(
            instance.constant - 0.5 * (p * Pp).sum(axis=1),
            abs(instance.constant) + (np.abs(p) * Pp_size).sum(axis=1),
        )
    fails = np.where(multiplier > 0, *n.fails)
    with np.errstate(invalid="ignore"):
        penalty = np.where(size > 0, size * fails, 0.0)
    _conditional(total, rows, penalty, low, high)
    loss = _alternatives(rows, penalty, c.allowed[here])
    total.add(-loss, loss)
    weight = size.sum(axis=1) + _balls(total, instance, c.ball[here])
    terms = 2 * (rows.count + 2 * instance.size + c.ball.shape[1] + 8)
    value = total.least(low, high, terms) - n.tolerance * 1.01 * weight
    if costs:
        far = np.maximum(np.abs(low - p), np.abs(high - p))
        bent = np.where(n.shift > 0, np.where(n.shift > 0, far, 0.0) ** 2 * n.shift, 0.0)
        value = value - 0.51 * bent.sum(axis=1)
    return np.asarray(down(value)), weight


def _times(left: Array, right: sparse.spmatrix) -> Array:
    """left @ right, dense."""
    return np.asarray((right.T @ left.T).T)


def _conditional(total: _Sum, rows: StatedRows, penalty: Array, low: Array, high: Array) -> None:
    """- M (1 - z) of rows that hold where z is 1, - M z of those that hold where it is 0."""
    for r in np.flatnonzero((rows.binary >= 0) & (penalty > 0).any(axis=0)):
        z, one = rows.binary[r], rows.value[r] == 1
        holds = (low[:, z] == rows.value[r]) & (high[:, z] == rows.value[r])
        m = np.where(holds, 0.0, penalty[:, r])
        if one:
            total.add(-m, m)
        total.slope[:, z] += m if one else -m
        total.slope_size[:, z] += m


def _alternatives(rows: StatedRows, penalty: Array, allowed: NDArray[np.bool_]) -> Array:
    """(S,) the most by which rows of alternatives fail, one alternative of each choice holding."""
    loss = np.zeros(len(penalty))
    each = np.zeros((len(rows.choice), len(penalty)))
    stated = np.flatnonzero((rows.alternative >= 0) & (penalty > 0).any(axis=0))
    np.add.at(each, rows.alternative[stated], penalty[:, stated].T)
    for k in np.unique(rows.choice):
        group = np.flatnonzero(rows.choice == k)
        worst = np.zeros(len(penalty))
        for r in group:
            others = each[group[group != r]].sum(axis=0)
            worst = np.where(allowed[:, r], np.maximum(worst, others), worst)
        loss += worst
    return loss


def _balls(total: _Sum, instance: Instance, ball: Array) -> Array:
    """b'(F x + f) - |b| r of every ball; (S,) the sum of |b|."""
    weight, at = np.zeros(len(ball)), 0
    for balls in instance.balls:
        d, F = balls.f.shape[1], sparse.csr_matrix(balls.F)
        b = ball[:, at : at + balls.count * d]
        at += balls.count * d
        total.add_slope(_times(b, F), _times(np.abs(b), abs(F)))
        length = np.linalg.norm(b.reshape(len(b), balls.count, d), axis=2)
        pull, size = b @ balls.f.ravel(), np.abs(b) @ np.abs(balls.f.ravel())
        reach = length @ balls.radius
        total.add(pull - reach, size + np.abs(reach))
        weight += length.sum(axis=1)
    return weight
