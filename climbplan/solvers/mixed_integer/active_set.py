"""Least-distance programs min 1/2 |v|^2 over lower <= M v <= upper, re-solved in compiled code.

The dual active-set method of Arnstroem, Bemporad and Axehill, "A dual active-set solver for
embedded quadratic programming using recursive LDL' updates" (IEEE TAC 2022), which is DAQP's:
multipliers stay of the right sign, so that their dual value is a bound whenever one stops, and a
child of a node starts from its parent's multipliers and factors. DAQP's own module is not called,
since each call from Python costs as much as a node, gives no multipliers of an infeasible
program, and its C structures are not an interface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer.compiling import compiled

SOLVED, EMPTY, CUT_OFF, STUCK = 0, 1, 2, 3

_SINGULAR = 1e-13  # squared distance of a unit row from the span of the others, taken for none
_NOTHING = 0.1  # share of a row's tolerance that does not make a program empty
_DUAL = 1e-12  # multipliers this far below zero are rounding
_REFINED = 1e-11  # residual of active rows above which multipliers are corrected
_MET = 1e-7  # residual of active rows from which they are not met
_GROWTH = 1e-13  # relative
_STALLED = 10  # rows without growth after which tolerances are let out tenfold
_LOOSEST = 100.0
_FAR = 1e300


class Rows(NamedTuple):
    """The rows of all nodes, of unit length."""

    M: Array  # (m, k)
    T: Array  # (k, m) the same by columns: loops over rows run along memory
    lower: Array  # (m,) of the node at hand
    upper: Array  # (m,)
    on: NDArray[np.uint8]  # (m,) which rows the node at hand has
    tolerance: Array  # (m,)
    used: NDArray[np.int64]  # (1,) how many there are; the rest is room
    stop: NDArray[np.uint8]  # (1,) set by whoever wants the search to end, while it runs


class Working(NamedTuple):
    """Active rows, their multipliers and the factors L D L' of their products."""

    row: NDArray[np.int64]  # (K,)
    side: Array  # (K,) 1 at the upper bound, -1 at the lower one
    multiplier: Array  # (K,) not negative, but of equations
    L: Array  # (K, K) unit lower triangle
    D: Array  # (K,)
    count: NDArray[np.int64]  # type: ignore[assignment]  # (1,) hides tuple.count
    active: NDArray[np.uint8]  # (m,) whether a row is in `row`
    v: Array  # (k,)
    value: Array  # (m,) M v
    ray: Array  # (K,) of an empty program: multipliers that prove it, by row of `ray_row`
    ray_row: NDArray[np.int64]  # (K,)
    ray_side: Array  # (K,)
    ray_count: NDArray[np.int64]  # (1,)
    spare: Array  # (3, K)
    iterations: NDArray[np.int64]  # (1,) all in all


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


@compiled
def _keep_ray(w: Working, row: int, side: float, a: Array) -> None:
    """The certificate: the new row, less its combination of the active ones."""
    n = w.count[0]
    for i in range(n):
        w.ray_row[i], w.ray_side[i], w.ray[i] = w.row[i], w.side[i], -a[i]
    w.ray_row[n], w.ray_side[n], w.ray[n] = row, side, 1.0
    w.ray_count[0] = n + 1


@compiled
def _slope(rows: Rows, w: Working) -> float:
    """What each step along the ray adds to the dual value."""
    slope = 0.0
    for i in range(w.ray_count[0]):
        slope -= w.ray[i] * _edge(rows, w.ray_row[i], w.ray_side[i])
    return slope


@compiled
def _most_violated(rows: Rows, w: Working, loose: float) -> tuple[int, float]:
    """The row that is violated most, -1 if none is, and its side."""
    worst, chosen, side = 0.0, -1, 1.0
    for i in range(rows.used[0]):
        if rows.on[i] == 0 or w.active[i] != 0:
            continue
        tolerance = loose * rows.tolerance[i]
        above = w.value[i] - rows.upper[i] - tolerance
        below = rows.lower[i] - w.value[i] - tolerance
        if above > worst:
            worst, chosen, side = above, i, 1.0
        if below > worst:
            worst, chosen, side = below, i, -1.0
    return chosen, side


@compiled
def _solve(rows: Rows, w: Working, cutoff: float, limit: int) -> int:
    """Re-solve from the active rows of `w`, which must be those of a program with other bounds.

    SOLVED with v and values; CUT_OFF once the dual value exceeds the cutoff; EMPTY with a ray;
    STUCK after `limit` iterations, or when told to stop. In every case the multipliers are of the
    right sign.
    """
    wanted, spare = w.spare[0], w.spare[1]
    highest, stalled, loose = -1.0, 0, 1.0
    fresh = False  # whether factors were made anew since the last trouble
    for _ in range(limit):
        if rows.stop[0]:
            return STUCK
        w.iterations[0] += 1
        n = w.count[0]
        for i in range(n):
            wanted[i] = -_edge(rows, w.row[i], w.side[i])
        _solve_factors(w, n, wanted)
        share, block = 1.0, -1
        for i in range(n):
            if wanted[i] < -_DUAL and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                held = max(w.multiplier[i], 0.0)
                room = held / (held - wanted[i])
                if room < share or block < 0:
                    share, block = room, i
        if block >= 0:
            for i in range(n):
                w.multiplier[i] += share * (wanted[i] - w.multiplier[i])
            _remove(w, block)
            continue
        for i in range(n):
            equation = rows.lower[w.row[i]] >= rows.upper[w.row[i]]
            w.multiplier[i] = wanted[i] if equation else max(wanted[i], 0.0)
        half = _primal(rows, w)
        # 1/2 |v|^2 is the dual value where active rows are met, which rounding may spoil
        if half > cutoff and _dual_value(rows, w) > cutoff:
            return CUT_OFF
        _values(rows, w)
        off = 0.0
        for i in range(n):
            spare[i] = w.side[i] * w.value[w.row[i]] - _edge(rows, w.row[i], w.side[i])
            off = max(off, abs(spare[i]))
        if off > _REFINED:
            _solve_factors(w, n, spare)
            for i in range(n):
                better = w.multiplier[i] + spare[i]
                if better >= 0.0 or rows.lower[w.row[i]] >= rows.upper[w.row[i]]:
                    w.multiplier[i] = better
            _primal(rows, w)
            _values(rows, w)
            again = 0.0
            for i in range(n):
                here = w.side[i] * w.value[w.row[i]] - _edge(rows, w.row[i], w.side[i])
                again = max(again, abs(here))
            if again > 1e3 * _REFINED and again > 0.1 * off and not fresh:
                _refactor(rows, w)
                fresh = True
                continue
            off = again
        # The dual value grows with every row; where it does not, rows are parallel but for rounding
        if half > highest + _GROWTH * abs(highest):
            highest, stalled = half, 0
        else:
            stalled += 1
            if stalled % _STALLED == 0 and loose < _LOOSEST:
                loose *= 10.0
        new, side = _most_violated(rows, w, loose)
        if new < 0:
            # Rows that contradict each other by little can be active together, and none be met
            if off <= _MET:
                return SOLVED
            if fresh:
                return STUCK
            _refactor(rows, w)
            fresh = True
            continue
        entered = 0.0  # multiplier of the new row so far
        while True:
            n = w.count[0]
            pivot = _pivot(rows, w, new, side)
            # Rounding may take a row or two too many for independent; there is no room for more
            if pivot > _SINGULAR and n < len(w.row) - 1:
                _append(w, new, side, entered, pivot)
                fresh = False
                break
            a = spare
            for i in range(n):
                a[i] = w.L[n, i]
            _backward(w, n, a)
            step, block = np.inf, -1
            for i in range(n):
                if a[i] > _DUAL and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                    room = w.multiplier[i] / a[i]
                    if room < step:
                        step, block = room, i
            if block < 0:
                _keep_ray(w, new, side, a)
                if _slope(rows, w) > _NOTHING * rows.tolerance[new]:
                    return EMPTY
                # Neither empty nor independent: the row says what active ones say already
                if not fresh:
                    _refactor(rows, w)
                    fresh = True
                elif loose < _LOOSEST:
                    loose *= 10.0
                else:
                    return STUCK
                break
            for i in range(n):
                w.multiplier[i] -= step * a[i]
                if rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                    w.multiplier[i] = max(w.multiplier[i], 0.0)
            entered += step
            _remove(w, block)
            fresh = False
    return STUCK


@compiled
def solve_rows(rows: Rows, w: Working, cutoff: float, limit: int) -> int:
    """Solve one program from the active rows of `w`; SOLVED, EMPTY, CUT_OFF or STUCK."""
    return _solve(rows, w, cutoff, limit)
