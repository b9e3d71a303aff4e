"""Boxes around the feasible set by interval propagation, with products of two variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange, RowPropagation

_ROUNDS = 40
_INTEGRALITY = 1e-6


@dataclass(frozen=True)
class VariableBox:
    """Bounds of every feasible x and of its products."""

    lower: Array  # (n,)
    upper: Array  # (n,)
    products: ElementwiseRange  # (K,)

    @property
    def half(self) -> Array:
        """Half the width, infinite where the box is open (n,)."""
        return 0.5 * (self.upper - self.lower)

    @property
    def middle(self) -> Array:
        """Center, 0 where the box is open (n,)."""
        closed = np.isfinite(self.lower) & np.isfinite(self.upper)
        low, high = np.where(closed, self.lower, 0.0), np.where(closed, self.upper, 0.0)
        return 0.5 * (low + high)

    def interval(
        self, A: sparse.csr_matrix, Q: sparse.csr_matrix | None = None
    ) -> ElementwiseRange:
        """Return the range of A x + Q w over the box, infinite where an entry is open."""
        minimum, maximum = _compute_interval(A, self.lower, self.upper)
        if Q is not None and Q.nnz:
            low, high = _compute_interval(Q, self.products.lower, self.products.upper)
            minimum, maximum = minimum + low, maximum + high
        return ElementwiseRange(minimum, maximum)


def compute_product_range(
    low: Array, high: Array, first: IntArray, second: IntArray
) -> ElementwiseRange:
    """Return the range of x[first] x[second] over low <= x <= high; squares are nonnegative."""
    ends = np.stack(
        [
            _multiply_ends(a[first], b[second])
            for a, b in ((low, low), (low, high), (high, low), (high, high))
        ]
    )
    minimum, maximum = ends.min(axis=0), ends.max(axis=0)
    crosses = (low[first] <= 0) & (high[first] >= 0)
    nearest = np.minimum(
        _multiply_ends(low[first], low[first]), _multiply_ends(high[first], high[first])
    )
    square = first == second
    return ElementwiseRange(np.where(square, np.where(crosses, 0.0, nearest), minimum), maximum)


@dataclass(frozen=True)
class Hulls:
    """Rows lower <= rows x <= upper for every alternative of every choice."""

    rows: sparse.csr_matrix  # (m, n)
    lower: Array  # (m,)
    upper: Array  # (m,)


def build_vertex_hulls(instance: Instance) -> Hulls:
    """Build boxes around the vertices of choices whose alternatives all have vertices."""
    rows = [sparse.csr_matrix((0, instance.size))]
    lower, upper = [np.zeros(0)], [np.zeros(0)]
    for choice in instance.choices:
        corners = [p.vertices for p in choice.alternatives if p.vertices is not None]
        if len(corners) == len(choice.alternatives) > 0:
            stacked = np.concatenate(corners)
            rows.append(choice.E)
            lower.append(stacked.min(axis=0) - choice.e)
            upper.append(stacked.max(axis=0) - choice.e)
    return Hulls(sparse.vstack(rows).tocsr(), np.concatenate(lower), np.concatenate(upper))


def propagate_box(instance: Instance, hulls: Hulls | None = None) -> VariableBox:
    """Tighten the variable bounds through rows, balls and hulls of choices.

    Binaries are rounded inwards. A variable without bounds keeps an infinite bound. An instance
    without a feasible point may give crossed bounds. `hulls` are those of the vertices by default.
    """
    n, products = instance.size, instance.products
    empty = sparse.csr_matrix
    rows, Q = [instance.A], [instance.Q]
    lower, upper = [instance.row_lower], [instance.row_upper]
    for balls in instance.balls:
        if balls.slope is not None:
            continue  # its vectors have no bound of their own
        radius = np.repeat(balls.radius, balls.f.shape[1])
        rows.append(balls.F)
        lower.append(-radius - balls.f.ravel())
        upper.append(radius - balls.f.ravel())
    choice_hulls = build_vertex_hulls(instance) if hulls is None else hulls
    rows.append(choice_hulls.rows)
    lower.append(choice_hulls.lower)
    upper.append(choice_hulls.upper)
    Q += [empty((block.shape[0], products.count)) for block in rows[1:]]
    all_rows = sparse.hstack([sparse.vstack(rows), sparse.vstack(Q)]).tocsr()
    return _propagate_rounds(all_rows, np.concatenate(lower), np.concatenate(upper), instance, n)


def _propagate_rounds(
    rows: sparse.csr_matrix, row_lower: Array, row_upper: Array, instance: Instance, n: int
) -> VariableBox:
    """Propagate over rows of variables and products, whose bounds follow from each other."""
    propagation = RowPropagation(rows, row_lower, row_upper)
    count = instance.products.count
    first, second = instance.products.first, instance.products.second
    low = np.concatenate([instance.lower, np.full(count, -np.inf)])
    high = np.concatenate([instance.upper, np.full(count, np.inf)])
    integer = np.flatnonzero(instance.integer)
    for _ in range(_ROUNDS):
        implied = compute_product_range(low[:n], high[:n], first, second)
        low[n:] = np.maximum(low[n:], implied.lower)
        high[n:] = np.minimum(high[n:], implied.upper)
        previous = ElementwiseRange(low, high)
        tightened = propagation.tighten(previous)
        low, high = tightened.lower, tightened.upper
        low[integer] = np.ceil(low[integer] - _INTEGRALITY)
        high[integer] = np.floor(high[integer] + _INTEGRALITY)
        if not previous.has_progressed(tightened) or (low > high).any():
            break
    implied = compute_product_range(low[:n], high[:n], first, second)
    products = ElementwiseRange(
        np.maximum(low[n:], implied.lower), np.minimum(high[n:], implied.upper)
    )
    return VariableBox(low[:n], high[:n], products)


def _multiply_ends(a: Array, b: Array) -> Array:
    """Return a b with 0 times infinity equal to 0, as interval ends need it."""
    with np.errstate(invalid="ignore"):
        return np.where((a == 0) | (b == 0), 0.0, a * b)


def _compute_interval(rows: sparse.csr_matrix, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the range of rows over a box."""
    positive, negative = rows.maximum(0), rows.minimum(0)
    positive.eliminate_zeros()
    negative.eliminate_zeros()
    return positive @ low + negative @ high, positive @ high + negative @ low
