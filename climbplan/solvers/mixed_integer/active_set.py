"""Solve least-distance programs min 1/2 |v|^2, lower <= M v <= upper, from a warm start.

This is the dual active-set method of Arnstroem, Bemporad and Axehill, "A dual active-set solver for
embedded quadratic programming using recursive LDL' updates" (IEEE TAC 2022), which DAQP implements.
The multipliers stay dual feasible, so that their dual value is a bound whenever the method stops. A
child of a node starts from its parent's multipliers and factors. Of many rows most steps look at
those only that were violated at the last look at all of them (partial pricing).

DAQP's own module is not called: each call from Python costs as much as a node, it returns no
multipliers of an infeasible program, and its C structures are no public interface.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.working_set import (
    _SINGULAR,
    WorkingSet,
    WorkingSetRows,
    _append_row,
    _compute_dual_value,
    _compute_pivot,
    _compute_primal,
    _compute_row_values,
    _dot,
    _find_right_side,
    _refactorise,
    _remove_row,
    _solve_factors,
    _substitute_backward,
)

SOLVED, EMPTY, CUT_OFF, STUCK = 0, 1, 2, 3

_NOTHING = 0.1  # slope of a ray, as a fraction of the tolerance, that proves nothing
_DUAL = 1e-12  # negative multipliers down to this are rounding errors
_REFINED = 1e-11  # residual of active rows above which multipliers are refined
_MET = 1e-7  # largest residual of active rows at a solution
_GROWTH = 1e-13  # relative growth of the dual value that counts as progress
_STALLED = 10  # rows without growth after which tolerances are relaxed tenfold
_LARGE = 10_000  # entries of rows from which most steps look at violated rows only
_POOLED = 0.1  # violation, relative to the largest, from which a row enters the pool
_LOOSEST = 100.0  # largest factor by which tolerances are relaxed


@compiled
def _store_ray(w: WorkingSet, row: int, side: float, a: Array) -> None:
    """Store the Farkas multipliers: those of the new row and of its combination of active rows."""
    n = w.count[0]
    for i in range(n):
        w.ray_row[i], w.ray_side[i], w.ray[i] = w.row[i], w.side[i], -a[i]
    w.ray_row[n], w.ray_side[n], w.ray[n] = row, side, 1.0
    w.ray_count[0] = n + 1


@compiled
def _compute_ray_slope(rows: WorkingSetRows, w: WorkingSet) -> float:
    """Return the growth of the dual value for each step along the ray."""
    slope = 0.0
    for i in range(w.ray_count[0]):
        slope -= w.ray[i] * _find_right_side(rows, w.ray_row[i], w.ray_side[i])
    return slope


@compiled
def _find_most_violated(
    rows: WorkingSetRows, w: WorkingSet, tolerance_factor: float
) -> tuple[int, float]:
    """Return the most violated row, -1 if there is none, and its side."""
    worst, chosen, side = 0.0, -1, 1.0
    for i in range(rows.num_used[0]):
        if rows.enabled[i] == 0 or w.active[i] != 0:
            continue
        tolerance = tolerance_factor * rows.tolerance[i]
        above = w.value[i] - rows.upper[i] - tolerance
        below = rows.lower[i] - w.value[i] - tolerance
        if above > worst:
            worst, chosen, side = above, i, 1.0
        if below > worst:
            worst, chosen, side = below, i, -1.0
    return chosen, side


@compiled
def _find_violated_in_pool(
    rows: WorkingSetRows, w: WorkingSet, tolerance_factor: float
) -> tuple[int, float]:
    """Return the most violated row of the pool, -1 if there is none, and its side."""
    worst, chosen, side = 0.0, -1, 1.0
    k = w.v.shape[0]
    for p in range(w.pool_count[0]):
        i = w.pool[p]
        if rows.enabled[i] == 0 or w.active[i] != 0:
            continue
        value = _dot(rows.M[i], w.v, k)
        tolerance = tolerance_factor * rows.tolerance[i]
        if value - rows.upper[i] - tolerance > worst:
            worst, chosen, side = value - rows.upper[i] - tolerance, i, 1.0
        if rows.lower[i] - value - tolerance > worst:
            worst, chosen, side = rows.lower[i] - value - tolerance, i, -1.0
    return chosen, side


@compiled
def _fill_pool(rows: WorkingSetRows, w: WorkingSet, row: int, side: float) -> None:
    """Put the rows into the pool that are violated nearly as much as the most violated one."""
    excess = side * w.value[row] - _find_right_side(rows, row, side)
    count = 0
    for i in range(rows.num_used[0]):
        if rows.enabled[i] == 0 or w.active[i] != 0:
            continue
        if max(w.value[i] - rows.upper[i], rows.lower[i] - w.value[i]) > _POOLED * excess:
            w.pool[count] = i
            count += 1
    w.pool_count[0] = count


@compiled
def _evaluate_rows(rows: WorkingSetRows, w: WorkingSet) -> float:
    """Compute M v; return the largest residual of active rows, all of which are in w.scratch[1]."""
    _compute_row_values(rows, w)
    residual, scratch = 0.0, w.scratch[1]
    for i in range(w.count[0]):
        right_side = _find_right_side(rows, w.row[i], w.side[i])
        scratch[i] = w.side[i] * w.value[w.row[i]] - right_side
        residual = max(residual, abs(scratch[i]))
    return residual


@compiled
def _refine_multipliers(rows: WorkingSetRows, w: WorkingSet) -> float:
    """Correct the multipliers by the residuals of active rows; return the new largest residual."""
    scratch, n = w.scratch[1], w.count[0]
    _solve_factors(w, n, scratch)
    for i in range(n):
        refined = w.multiplier[i] + scratch[i]
        if refined >= 0.0 or rows.lower[w.row[i]] >= rows.upper[w.row[i]]:
            w.multiplier[i] = refined
    _compute_primal(rows, w)
    return _evaluate_rows(rows, w)


@compiled
def _solve_least_distance(rows: WorkingSetRows, w: WorkingSet, cutoff: float, limit: int) -> int:
    """Re-solve from the working set of a program that has the same rows with other bounds.

    Returns:
        SOLVED with v and values; CUT_OFF once the dual value exceeds the cutoff; EMPTY with a ray;
        STUCK after `limit` iterations or when stopped. The multipliers are dual feasible in every
        case.
    """
    target, scratch = w.scratch[0], w.scratch[1]
    best_dual_value, stalled, tolerance_factor = -1.0, 0, 1.0
    is_refactored = False  # whether the factors are new since the last numerical difficulty
    is_large = rows.num_used[0] * w.v.shape[0] > _LARGE
    for _ in range(limit):
        if rows.stop[0]:
            return STUCK
        w.iterations[0] += 1
        n = w.count[0]
        for i in range(n):
            target[i] = -_find_right_side(rows, w.row[i], w.side[i])
        _solve_factors(w, n, target)
        step_length, block = 1.0, -1
        for i in range(n):
            if target[i] < -_DUAL and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                multiplier = max(w.multiplier[i], 0.0)
                ratio = multiplier / (multiplier - target[i])
                if ratio < step_length or block < 0:
                    step_length, block = ratio, i
        if block >= 0:
            for i in range(n):
                w.multiplier[i] += step_length * (target[i] - w.multiplier[i])
            _remove_row(w, block)
            continue
        for i in range(n):
            equation = rows.lower[w.row[i]] >= rows.upper[w.row[i]]
            w.multiplier[i] = target[i] if equation else max(target[i], 0.0)
        dual_value = _compute_primal(rows, w)
        # 1/2 |v|^2 is the dual value only if active rows hold exactly
        if dual_value > cutoff and _compute_dual_value(rows, w) > cutoff:
            return CUT_OFF
        # The dual value grows with every row, unless rows are parallel up to rounding
        if dual_value > best_dual_value + _GROWTH * abs(best_dual_value):
            best_dual_value, stalled = dual_value, 0
        else:
            stalled += 1
            if stalled % _STALLED == 0 and tolerance_factor < _LOOSEST:
                tolerance_factor *= 10.0
        new, side = -1, 1.0
        if is_large:
            new, side = _find_violated_in_pool(rows, w, tolerance_factor)
        if new < 0:
            residual = _evaluate_rows(rows, w)
            if residual > _REFINED:
                refined_residual = _refine_multipliers(rows, w)
                is_no_better = refined_residual > max(1e3 * _REFINED, 0.1 * residual)
                if is_no_better and not is_refactored:
                    _refactorise(rows, w)
                    is_refactored = True
                    continue
                residual = refined_residual
            new, side = _find_most_violated(rows, w, tolerance_factor)
            if new < 0:
                # Slightly contradictory rows can be active together although none of them holds
                if residual <= _MET:
                    return SOLVED
                if is_refactored:
                    return STUCK
                _refactorise(rows, w)
                is_refactored = True
                continue
            if is_large:
                _fill_pool(rows, w, new, side)
        entered = 0.0  # multiplier of the new row so far
        while True:
            n = w.count[0]
            pivot = _compute_pivot(rows, w, new, side)
            # Rounding may classify dependent rows as independent; the arrays hold no more
            if pivot > _SINGULAR and n < len(w.row) - 1:
                _append_row(w, new, side, entered, pivot)
                is_refactored = False
                break
            a = scratch
            for i in range(n):
                a[i] = w.L[n, i]
            _substitute_backward(w, n, a)
            step, block = np.inf, -1
            for i in range(n):
                if a[i] > _DUAL and rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                    ratio = w.multiplier[i] / a[i]
                    if ratio < step:
                        step, block = ratio, i
            if block < 0:
                _store_ray(w, new, side, a)
                if _compute_ray_slope(rows, w) > _NOTHING * rows.tolerance[new]:
                    return EMPTY
                # The row is dependent and consistent: active rows imply it
                if not is_refactored:
                    _refactorise(rows, w)
                    is_refactored = True
                elif tolerance_factor < _LOOSEST:
                    tolerance_factor *= 10.0
                else:
                    return STUCK
                break
            for i in range(n):
                w.multiplier[i] -= step * a[i]
                if rows.lower[w.row[i]] < rows.upper[w.row[i]]:
                    w.multiplier[i] = max(w.multiplier[i], 0.0)
            entered += step
            _remove_row(w, block)
            is_refactored = False
    return STUCK


@compiled
def solve_least_distance(rows: WorkingSetRows, w: WorkingSet, cutoff: float, limit: int) -> int:
    """Solve one program from its working set; return SOLVED, EMPTY, CUT_OFF or STUCK."""
    return _solve_least_distance(rows, w, cutoff, limit)
