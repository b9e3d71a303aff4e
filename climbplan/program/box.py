"""Boxes around the feasible set by interval propagation, products of two variables included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.program.row_propagation import Range, RowPropagation

_ROUNDS = 40
_INTEGRALITY = 1e-6


@dataclass(frozen=True)
class Box:
    """Bounds that hold for every feasible x and for its products."""

    lower: Array  # (n,)
    upper: Array  # (n,)
    products: Range  # (K,)

    def interval(self, A: sparse.csr_matrix, Q: sparse.csr_matrix | None = None) -> Range:
        """Range of A x + Q w over the box, infinite where something in it is."""
        least, most = _interval(A, self.lower, self.upper)
        if Q is not None and Q.nnz:
            low, high = _interval(Q, self.products.lower, self.products.upper)
            least, most = least + low, most + high
        return Range(least, most)


def product_range(low: Array, high: Array, first: Index, second: Index) -> Range:
    """Range of x[first] x[second] over low <= x <= high; squares are not negative."""
    ends = np.stack(
        [
            _times(a[first], b[second])
            for a, b in ((low, low), (low, high), (high, low), (high, high))
        ]
    )
    least, most = ends.min(axis=0), ends.max(axis=0)
    crosses = (low[first] <= 0) & (high[first] >= 0)
    nearest = np.minimum(_times(low[first], low[first]), _times(high[first], high[first]))
    square = first == second
    return Range(np.where(square, np.where(crosses, 0.0, nearest), least), most)


def propagated_box(instance: Instance) -> Box:
    """The variable bounds, tightened through rows, balls and the vertices of choices.

    Binaries are rounded inwards. A variable that nothing bounds keeps an infinite bound. An
    instance without a feasible point may give crossed bounds.
    """
    n, products = instance.size, instance.products
    empty = sparse.csr_matrix
    rows, Q = [instance.A], [instance.Q]
    lower, upper = [instance.row_lower], [instance.row_upper]
    for balls in instance.balls:
        radius = np.repeat(balls.radius, balls.f.shape[1])
        rows.append(balls.F)
        lower.append(-radius - balls.f.ravel())
        upper.append(radius - balls.f.ravel())
    for choice in instance.choices:
        corners = [p.vertices for p in choice.alternatives if p.vertices is not None]
        if len(corners) == len(choice.alternatives) > 0:
            stacked = np.concatenate(corners)
            rows.append(choice.E)
            lower.append(stacked.min(axis=0) - choice.e)
            upper.append(stacked.max(axis=0) - choice.e)
    Q += [empty((part.shape[0], products.count)) for part in rows[1:]]
    whole = sparse.hstack([sparse.vstack(rows), sparse.vstack(Q)]).tocsr()
    return _propagate(whole, np.concatenate(lower), np.concatenate(upper), instance, n)


def _propagate(
    rows: sparse.csr_matrix, row_lower: Array, row_upper: Array, instance: Instance, n: int
) -> Box:
    """Rounds over rows of variables and products, whose bounds follow from each other."""
    propagation = RowPropagation(rows, row_lower, row_upper)
    count = instance.products.count
    first, second = instance.products.first, instance.products.second
    low = np.concatenate([instance.lower, np.full(count, -np.inf)])
    high = np.concatenate([instance.upper, np.full(count, np.inf)])
    integer = np.flatnonzero(instance.integer)
    for _ in range(_ROUNDS):
        implied = product_range(low[:n], high[:n], first, second)
        low[n:] = np.maximum(low[n:], implied.lower)
        high[n:] = np.minimum(high[n:], implied.upper)
        before = Range(low, high)
        after = propagation.tightened(before)
        low, high = after.lower, after.upper
        low[integer] = np.ceil(low[integer] - _INTEGRALITY)
        high[integer] = np.floor(high[integer] + _INTEGRALITY)
        if not before.moved_to(after) or (low > high).any():
            break
    implied = product_range(low[:n], high[:n], first, second)
    products = Range(np.maximum(low[n:], implied.lower), np.minimum(high[n:], implied.upper))
    return Box(low[:n], high[:n], products)


def _times(a: Array, b: Array) -> Array:
    """a b with 0 times infinity equal to 0, as interval ends need it."""
    with np.errstate(invalid="ignore"):
        return np.where((a == 0) | (b == 0), 0.0, a * b)


def _interval(rows: sparse.csr_matrix, low: Array, high: Array) -> tuple[Array, Array]:
    positive, negative = rows.maximum(0), rows.minimum(0)
    positive.eliminate_zeros()
    negative.eliminate_zeros()
    return positive @ low + negative @ high, positive @ high + negative @ low
