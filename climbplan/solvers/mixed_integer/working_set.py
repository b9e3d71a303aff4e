"""Active rows of a least-distance program, with multipliers and the factors of their products.

What `active_set` is made of: each function is one step of linear algebra on arrays that it is
given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled

_SINGULAR = 1e-13  # squared distance of a unit row from the span of the others, taken for none
_FAR = 1e300


class Rows(NamedTuple):
    """The rows of all nodes, of unit length."""

    M: Array  # (m, k)
    T: Array  # (k, m) the same by columns: loops over rows run along memory
    lower: Array  # (m,) of the node at hand
    upper: Array  # (m,)
    on: NDArray[np.uint8]  # (m,) which rows the node at hand has
    tolerance: Array  # (m,)
    used: IntArray  # (1,) how many there are; the rest is room
    stop: NDArray[np.uint8]  # (1,) set by whoever wants the search to end, while it runs


class Working(NamedTuple):
    """Active rows, their multipliers and the factors L D L' of their products."""

    row: IntArray  # (K,)
    side: Array  # (K,) 1 at the upper bound, -1 at the lower one
    multiplier: Array  # (K,) not negative, but of equations
    L: Array  # (K, K) unit lower triangle
    D: Array  # (K,)
    count: IntArray  # type: ignore[assignment]  # (1,) hides tuple.count
    active: NDArray[np.uint8]  # (m,) whether a row is in `row`
    v: Array  # (k,)
    value: Array  # (m,) M v
    ray: Array  # (K,) of an empty program: multipliers that prove it, by row of `ray_row`
    ray_row: IntArray  # (K,)
    ray_side: Array  # (K,)
    ray_count: IntArray  # (1,)
    spare: Array  # (3, K)
    iterations: IntArray  # (1,) all in all


def working(rows: int, columns: int) -> Working:
    """Room for the active rows of a program."""
    K = columns + 2
    return Working(
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
        spare=np.zeros((3, K)),
        iterations=np.zeros(1, np.int64),
    )


@compiled
def _copy_working(source: Working, into: Working) -> None:
    """Active rows with factors; values and rays are left."""
    n = source.count[0]
    for i in range(into.count[0]):
        into.active[into.row[i]] = 0
    into.count[0] = n
    for i in range(n):
        into.row[i] = source.row[i]
        into.side[i] = source.side[i]
        into.multiplier[i] = source.multiplier[i]
        into.D[i] = source.D[i]
        into.active[source.row[i]] = 1
        for j in range(i):
            into.L[i, j] = source.L[i, j]


@compiled
def _clear(w: Working) -> None:
    for i in range(w.count[0]):
        w.active[w.row[i]] = 0
    w.count[0] = 0


@compiled
def _edge(rows: Rows, row: int, side: float) -> float:
    """d of side * M[row] v <= d."""
    return rows.upper[row] if side > 0 else -rows.lower[row]


@compiled
def _forward(w: Working, count: int, x: Array) -> None:
    for i in range(count):
        total = x[i]
        for j in range(i):
            total -= w.L[i, j] * x[j]
        x[i] = total


@compiled
def _backward(w: Working, count: int, x: Array) -> None:
    for i in range(count - 1, -1, -1):
        total = x[i]
        for j in range(i):
            x[j] -= w.L[i, j] * total


@compiled
def _solve_factors(w: Working, count: int, x: Array) -> None:
    """x <- (L D L')^-1 x."""
    _forward(w, count, x)
    for i in range(count):
        x[i] /= w.D[i]
    _backward(w, count, x)


@compiled
def _pivot(rows: Rows, w: Working, row: int, side: float) -> float:
    """Squared distance of a row from the span of the active ones; fills w.L's next line."""
    n = w.count[0]
    line = w.L[n]
    new = rows.M[row]
    length = 0.0
    for j in range(new.shape[0]):
        length += new[j] * new[j]
    for i in range(n):
        other = rows.M[w.row[i]]
        total = 0.0
        for j in range(new.shape[0]):
            total += new[j] * other[j]
        line[i] = total * side * w.side[i]
    _forward(w, n, line)
    for i in range(n):
        scaled = line[i] / w.D[i]
        length -= line[i] * scaled
        line[i] = scaled
    return length


@compiled
def _append(w: Working, row: int, side: float, multiplier: float, pivot: float) -> None:
    n = w.count[0]
    w.row[n], w.side[n], w.multiplier[n], w.D[n] = row, side, multiplier, pivot
    w.active[row] = 1
    w.count[0] = n + 1


@compiled
def _remove(w: Working, place: int) -> None:
    """Drop an active row: what stands below it is updated by a term of rank one."""
    n = w.count[0]
    w.active[w.row[place]] = 0
    p = w.spare[2]
    weight = w.D[place]
    for i in range(place + 1, n):
        p[i - 1] = w.L[i, place]
    for i in range(place + 1, n):
        w.row[i - 1], w.side[i - 1] = w.row[i], w.side[i]
        w.multiplier[i - 1], w.D[i - 1] = w.multiplier[i], w.D[i]
        for j in range(place):
            w.L[i - 1, j] = w.L[i, j]
        for j in range(place + 1, i):
            w.L[i - 1, j - 1] = w.L[i, j]
    n -= 1
    w.count[0] = n
    for j in range(place, n):
        old = w.D[j]
        first = p[j]
        new = old + weight * first * first
        w.D[j] = new
        factor = weight * first / new
        weight *= old / new
        for i in range(j + 1, n):
            p[i] -= first * w.L[i, j]
            w.L[i, j] += factor * p[i]


@compiled
def _refactor(rows: Rows, w: Working) -> None:
    """Factors anew from the active rows; those that depend on others are dropped."""
    n = w.count[0]
    w.count[0] = 0
    for i in range(n):
        w.active[w.row[i]] = 0
    for i in range(n):
        if rows.stop[0]:
            break
        row, side, multiplier = w.row[i], w.side[i], w.multiplier[i]
        pivot = _pivot(rows, w, row, side)
        if pivot > _SINGULAR and w.count[0] < len(w.row) - 1:
            _append(w, row, side, multiplier, pivot)


@compiled
def _primal(rows: Rows, w: Working) -> float:
    """v, M v of the multipliers; 1/2 |v|^2."""
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
def _values(rows: Rows, w: Working) -> None:
    m = rows.used[0]
    for i in range(m):
        w.value[i] = 0.0
    for j in range(w.v.shape[0]):
        scale = w.v[j]
        if scale != 0.0:
            column = rows.T[j]
            for i in range(m):
                w.value[i] += scale * column[i]


@compiled
def _dual_value(rows: Rows, w: Working) -> float:
    """-1/2 |M'l|^2 - d'l of the multipliers as they stand: a bound whatever they are."""
    value = -_primal(rows, w)
    for i in range(w.count[0]):
        if w.multiplier[i] != 0.0:
            value -= w.multiplier[i] * _edge(rows, w.row[i], w.side[i])
    return value


@compiled
def _drop_absent(rows: Rows, w: Working) -> None:
    """Active rows that the node at hand has not, or whose bound is infinite, leave."""
    for i in range(w.count[0] - 1, -1, -1):
        row = w.row[i]
        if rows.on[row] == 0 or abs(_edge(rows, row, w.side[i])) > _FAR:
            _remove(w, i)
    for i in range(w.count[0]):
        if w.multiplier[i] < 0.0 and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
            w.multiplier[i] = 0.0  # was an equation
