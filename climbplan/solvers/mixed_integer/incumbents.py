"""Primal heuristics at a node: rounding of its relaxation, and relaxations that are integral."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import SOLVED
from climbplan.solvers.mixed_integer.bounds import (
    _adapt_working_set,
    _apply_node_ranges,
    _compute_bound,
    _evaluate_objective,
    _solve_with_cuts,
)
from climbplan.solvers.mixed_integer.compiling import as_runtime_constant, compiled
from climbplan.solvers.mixed_integer.nodes import (
    FEASIBILITY,
    INCUMBENT_COST,
    NUM_FIXED_SOLVES,
    NUM_INCUMBENTS,
    SearchState,
    _compute_dual_cutoff,
)
from climbplan.solvers.mixed_integer.problem_data import ProblemData
from climbplan.solvers.mixed_integer.spatial import _locate_cell
from climbplan.solvers.mixed_integer.tangent_cuts import _max_ball_violation
from climbplan.solvers.mixed_integer.working_set import _copy_working_set

_CLOSE_ROUNDS = as_runtime_constant(60)  # rounds of tangent cuts at candidates for the incumbent


@compiled
def _round_relaxation(
    n: ProblemData, s: SearchState, low: IntArray, high: IntArray, rounded: IntArray
) -> None:
    """Round every undecided integer to its nearest value; of a group the largest becomes 1."""
    E = len(n.value_row)
    for e in range(E):
        if low[e] == high[e]:
            rounded[e] = low[e]
            continue
        r = n.value_row[e]
        if n.spatial.cell_width[e] > 0.0:
            value = n.norm[r] * s.main.value[r] + s.offset[r]
            rounded[e] = _locate_cell(n.spatial, e, value, low[e], high[e])
        elif r >= 0:
            value = n.norm[r] * s.main.value[r] + s.offset[r]
            rounded[e] = min(max(np.int64(np.round(value)), low[e]), high[e])
        else:
            rounded[e] = 1 if s.distance[1, e] <= s.distance[0, e] else 0
    for e in range(E):
        if n.group[e] < 0:
            continue
        best, chosen = -np.inf, -1
        is_first_of_group = True
        for f in range(E):
            if n.group[f] != n.group[e]:
                continue
            if f < e:
                is_first_of_group = False
                break
            value = n.norm[n.value_row[f]] * s.main.value[n.value_row[f]] + s.offset[n.value_row[f]]
            if low[f] == high[f]:
                value = 2.0 * low[f] - 1.0
            if value > best:
                best, chosen = value, f
        if is_first_of_group:
            for f in range(e, E):
                if n.group[f] == n.group[e] and low[f] < high[f]:
                    rounded[f] = 1 if f == chosen else 0


@compiled
def _update_incumbent(s: SearchState, integers: IntArray, objective: float) -> None:
    """Store the current point as the incumbent."""
    s.scalars[INCUMBENT_COST] = objective
    for j in range(len(s.w)):
        s.best_w[j] = s.w[j]
    for e in range(len(integers)):
        s.best_integers[e] = integers[e]
    s.counters[NUM_INCUMBENTS] += 1


@compiled
def _solve_fixed_integers(n: ProblemData, s: SearchState, integers: IntArray, limit: int) -> bool:
    """Solve the program with all integers fixed; return whether it improves the incumbent."""
    _copy_working_set(s.main, s.probe)
    _apply_node_ranges(n, s, integers, integers)
    _adapt_working_set(n, s, s.probe)
    s.counters[NUM_FIXED_SOLVES] += 1
    tolerance = s.scalars[FEASIBILITY]
    status = _solve_with_cuts(
        n, s, s.probe, _compute_dual_cutoff(s), limit, _CLOSE_ROUNDS, tolerance
    )
    if status != SOLVED:
        return False
    _compute_bound(n, s, s.probe)
    if _max_ball_violation(n, s) > 1.5 * tolerance:
        return False
    objective = _evaluate_objective(n, s.w)
    if objective >= s.scalars[INCUMBENT_COST]:
        return False
    _update_incumbent(s, integers, objective)
    return True


@compiled
def _accept_integral_node(n: ProblemData, s: SearchState, integers: IntArray) -> bool:
    """Accept the solution of a node whose relaxation is integral, which is optimal in it.

    Returns:
        Whether columns were rounded, so that the program has to be solved with integers fixed.
    """
    rounded = False
    for e in range(len(n.value_row)):
        integers[e] = _find_integral_value(n, s, e)
        undecided = s.low[e] < s.high[e] and n.spatial.cell_width[e] == 0.0
        rounded = rounded or (undecided and n.value_row[e] >= 0)
    objective = _evaluate_objective(n, s.w)
    if objective >= s.scalars[INCUMBENT_COST]:
        return False
    if not rounded:
        _update_incumbent(s, integers, objective)
    return rounded


@compiled
def _find_integral_value(n: ProblemData, s: SearchState, e: int) -> Any:
    """Return the value of an integer at a point that is integral up to tolerances."""
    if s.low[e] == s.high[e]:
        return s.low[e]
    r = n.value_row[e]
    if n.spatial.cell_width[e] > 0.0:
        value = n.norm[r] * s.main.value[r] + s.offset[r]
        return _locate_cell(n.spatial, e, value, s.low[e], s.high[e])
    if r >= 0:
        return np.int64(np.round(n.norm[r] * s.main.value[r] + s.offset[r]))
    return 1 if s.distance[1, e] == 0.0 else 0
