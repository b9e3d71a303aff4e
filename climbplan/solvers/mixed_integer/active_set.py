"""Least-distance programs min 1/2 |v|^2 over lower <= M v <= upper, re-solved in compiled code.

The dual active-set method of Arnstroem, Bemporad and Axehill, "A dual active-set solver for
embedded quadratic programming using recursive LDL' updates" (IEEE TAC 2022), which is DAQP's:
multipliers stay of the right sign, so that their dual value is a bound whenever one stops, and a
child of a node starts from its parent's multipliers and factors. DAQP's own module is not called,
since each call from Python costs as much as a node, gives no multipliers of an infeasible
program, and its C structures are not an interface.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.working_set import (
    _SINGULAR,
    Rows,
    Working,
    _append,
    _backward,
    _dual_value,
    _edge,
    _pivot,
    _primal,
    _refactor,
    _remove,
    _solve_factors,
    _values,
)

SOLVED, EMPTY, CUT_OFF, STUCK = 0, 1, 2, 3

_NOTHING = 0.1  # share of a row's tolerance that does not make a program empty
_DUAL = 1e-12  # multipliers this far below zero are rounding
_REFINED = 1e-11  # residual of active rows above which multipliers are corrected
_MET = 1e-7  # residual of active rows from which they are not met
_GROWTH = 1e-13  # relative
_STALLED = 10  # rows without growth after which tolerances are let out tenfold
_LOOSEST = 100.0


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
