"""Working set of a least-distance program: active rows, multipliers and an L D L' factorisation.

The functions are the linear algebra of the solver in `active_set`; all work in place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_SINGULAR = 1e-13  # squared distance from the span of active rows at which a row is dependent
_FAR = 1e300


class WorkingSetRows(NamedTuple):
    """The rows of all nodes, scaled to unit length."""

    M: Array  # (m, k)
    T: Array  # (k, m) transpose of M, so that loops over rows run along memory
    lower: Array  # (m,) bounds at the current node
    upper: Array  # (m,)
    enabled: NDArray[np.uint8]  # (m,) whether the current node has the row
    tolerance: Array  # (m,)
    num_used: IntArray  # (1,) number of rows; the rest is spare capacity
    stop: NDArray[np.uint8]  # (1,) set from another thread to end the search


class WorkingSet(NamedTuple):
    """Active rows, their multipliers and the factors L D L' of their Gram matrix."""

    row: IntArray  # (K,)
    side: Array  # (K,) 1 at the upper bound, -1 at the lower one
    multiplier: Array  # (K,) nonnegative, except for equations
    L: Array  # (K, K) unit lower triangle
    D: Array  # (K,)
    count: IntArray  # type: ignore[assignment]  # (1,) hides tuple.count
    active: NDArray[np.uint8]  # (m,) whether a row is in `row`
    v: Array  # (k,)
    value: Array  # (m,) M v
    ray: Array  # (K,) Farkas multipliers of an infeasible program, for the rows in `ray_row`
    ray_row: IntArray  # (K,)
    ray_side: Array  # (K,)
    ray_count: IntArray  # (1,)
    scratch: Array  # (3, K)
    pool: IntArray  # (m,) rows that were violated at the last look at all rows
    pool_count: IntArray  # (1,)
    iterations: IntArray  # (1,) total over all solves


def allocate_working_set(rows: int, columns: int) -> WorkingSet:
    """Allocate an empty working set for a program of some rows and columns."""
    K = columns + 2
    return WorkingSet(
        row=np.zeros(K, np.int64),
        side=np.zeros(K),
        multiplier=np.zeros(K),
        L=np.zeros((K, K)),
        D=np.zeros(K),
        count=np.zeros(1, np.int64),
        active=np.zeros(rows, np.uint8),
        v=np.zeros(columns),
        value=np.zeros(rows),
        ray=np.zeros(K),
        ray_row=np.zeros(K, np.int64),
        ray_side=np.zeros(K),
        ray_count=np.zeros(1, np.int64),
        scratch=np.zeros((3, K)),
        pool=np.zeros(rows, np.int64),
        pool_count=np.zeros(1, np.int64),
        iterations=np.zeros(1, np.int64),
    )


@compiled
def _copy_working_set(source: WorkingSet, target: WorkingSet) -> None:
    """Copy active rows with their factors; values and rays are not copied."""
    n = source.count[0]
    for i in range(target.count[0]):
        target.active[target.row[i]] = 0
    target.count[0] = n
    for i in range(n):
        target.row[i] = source.row[i]
        target.side[i] = source.side[i]
        target.multiplier[i] = source.multiplier[i]
        target.D[i] = source.D[i]
        target.active[source.row[i]] = 1
        for j in range(i):
            target.L[i, j] = source.L[i, j]


@compiled
def _clear_working_set(w: WorkingSet) -> None:
    """Remove all active rows."""
    for i in range(w.count[0]):
        w.active[w.row[i]] = 0
    w.count[0] = 0


@compiled
def _find_right_side(rows: WorkingSetRows, row: int, side: float) -> float:
    """Return d of side * M[row] v <= d."""
    return rows.upper[row] if side > 0 else -rows.lower[row]


@compiled
def _dot(x: Array, y: Array, count: int) -> float:
    """Return the sum of x_j y_j over j < count, in four sums that do not wait for each other."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    quarter = count - count % 4
    for j in range(0, quarter, 4):
        a += x[j] * y[j]
        b += x[j + 1] * y[j + 1]
        c += x[j + 2] * y[j + 2]
        d += x[j + 3] * y[j + 3]
    for j in range(quarter, count):
        a += x[j] * y[j]
    return (a + b) + (c + d)


@compiled
def _substitute_forward(w: WorkingSet, count: int, x: Array) -> None:
    """Solve L x = x in place."""
    for i in range(count):
        x[i] -= _dot(w.L[i], x, i)


@compiled
def _substitute_backward(w: WorkingSet, count: int, x: Array) -> None:
    """Solve L' x = x in place."""
    for i in range(count - 1, -1, -1):
        total = x[i]
        for j in range(i):
            x[j] -= w.L[i, j] * total


@compiled
def _solve_factors(w: WorkingSet, count: int, x: Array) -> None:
    """Solve (L D L') x = x in place."""
    _substitute_forward(w, count, x)
    for i in range(count):
        x[i] /= w.D[i]
    _substitute_backward(w, count, x)


@compiled
def _compute_pivot(rows: WorkingSetRows, w: WorkingSet, row: int, side: float) -> float:
    """Return the squared distance of a row from the span of the active ones.

    The next line of L is filled for `_append_row`.
    """
    n = w.count[0]
    line = w.L[n]
    new = rows.M[row]
    k = new.shape[0]
    length = _dot(new, new, k)
    for i in range(n):
        line[i] = _dot(new, rows.M[w.row[i]], k) * side * w.side[i]
    _substitute_forward(w, n, line)
    for i in range(n):
        scaled = line[i] / w.D[i]
        length -= line[i] * scaled
        line[i] = scaled
    return length


@compiled
def _append_row(w: WorkingSet, row: int, side: float, multiplier: float, pivot: float) -> None:
    """Append a row to the working set, whose line of L is in place."""
    n = w.count[0]
    w.row[n], w.side[n], w.multiplier[n], w.D[n] = row, side, multiplier, pivot
    w.active[row] = 1
    w.count[0] = n + 1


@compiled
def _remove_row(w: WorkingSet, position: int) -> None:
    """Remove an active row; the factors below it get a rank-one update."""
    n = w.count[0]
    w.active[w.row[position]] = 0
    p = w.scratch[2]
    weight = w.D[position]
    for i in range(position + 1, n):
        p[i - 1] = w.L[i, position]
    for i in range(position + 1, n):
        w.row[i - 1], w.side[i - 1] = w.row[i], w.side[i]
        w.multiplier[i - 1], w.D[i - 1] = w.multiplier[i], w.D[i]
        for j in range(position):
            w.L[i - 1, j] = w.L[i, j]
        for j in range(position + 1, i):
            w.L[i - 1, j - 1] = w.L[i, j]
    n -= 1
    w.count[0] = n
    for j in range(position, n):
        old_pivot = w.D[j]
        first = p[j]
        new_pivot = old_pivot + weight * first * first
        w.D[j] = new_pivot
        factor = weight * first / new_pivot
        weight *= old_pivot / new_pivot
        for i in range(j + 1, n):
            p[i] -= first * w.L[i, j]
            w.L[i, j] += factor * p[i]


@compiled
def _refactorise(rows: WorkingSetRows, w: WorkingSet) -> None:
    """Recompute the factors from the active rows; linearly dependent rows are dropped."""
    n = w.count[0]
    w.count[0] = 0
    for i in range(n):
        w.active[w.row[i]] = 0
    for i in range(n):
        if rows.stop[0]:
            break
        row, side, multiplier = w.row[i], w.side[i], w.multiplier[i]
        pivot = _compute_pivot(rows, w, row, side)
        if pivot > _SINGULAR and w.count[0] < len(w.row) - 1:
            _append_row(w, row, side, multiplier, pivot)


@compiled
def _compute_primal(rows: WorkingSetRows, w: WorkingSet) -> float:
    """Compute v from the multipliers; return 1/2 |v|^2."""
    k = w.v.shape[0]
    for j in range(k):
        w.v[j] = 0.0
    for i in range(w.count[0]):
        scale = -w.side[i] * w.multiplier[i]
        if scale != 0.0:
            line = rows.M[w.row[i]]
            for j in range(k):
                w.v[j] += scale * line[j]
    total = 0.0
    for j in range(k):
        total += w.v[j] * w.v[j]
    return 0.5 * total


@compiled
def _compute_row_values(rows: WorkingSetRows, w: WorkingSet) -> None:
    """Compute M v."""
    m = rows.num_used[0]
    for i in range(m):
        w.value[i] = 0.0
    for j in range(w.v.shape[0]):
        scale = w.v[j]
        if scale != 0.0:
            column = rows.T[j]
            for i in range(m):
                w.value[i] += scale * column[i]


@compiled
def _compute_dual_value(rows: WorkingSetRows, w: WorkingSet) -> float:
    """Return -1/2 |M'l|^2 - d'l of the multipliers l, which is a bound whatever they are."""
    value = -_compute_primal(rows, w)
    for i in range(w.count[0]):
        if w.multiplier[i] != 0.0:
            value -= w.multiplier[i] * _find_right_side(rows, w.row[i], w.side[i])
    return value


@compiled
def _remove_disabled_rows(rows: WorkingSetRows, w: WorkingSet) -> None:
    """Remove active rows that the current node lacks, or whose bound is infinite."""
    for i in range(w.count[0] - 1, -1, -1):
        row = w.row[i]
        if rows.enabled[row] == 0 or abs(_find_right_side(rows, row, w.side[i])) > _FAR:
            _remove_row(w, i)
    for i in range(w.count[0]):
        if w.multiplier[i] < 0.0 and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
            w.multiplier[i] = 0.0  # was an equation
