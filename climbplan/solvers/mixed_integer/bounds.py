"""Solve relaxations of nodes and compute the bounds that they prove.

Every bound is the dual value of dual feasible multipliers, less the largest effect of the proximal
term within the box and of rounding. It is therefore valid even when a limit stops the solver. Balls
enter as tangent cuts, which are valid in the whole tree.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.active_set import EMPTY, SOLVED, STUCK, _solve_least_distance
from climbplan.solvers.mixed_integer.compiling import as_runtime_constant, compiled
from climbplan.solvers.mixed_integer.nodes import (
    _LOSS,
    CONSTANT,
    GAP,
    INCUMBENT_COST,
    SearchState,
    _compute_cutoff,
    _compute_dual_cutoff,
)
from climbplan.solvers.mixed_integer.problem_data import ALWAYS, DECIDED, ProblemData
from climbplan.solvers.mixed_integer.spatial import _find_range_end, _update_envelopes
from climbplan.solvers.mixed_integer.tangent_cuts import _add_tangent_cuts
from climbplan.solvers.mixed_integer.working_set import (
    WorkingSet,
    _compute_dual_value,
    _find_right_side,
    _refactorise,
    _remove_disabled_rows,
)
from climbplan.solvers.result import MIN_OBJECTIVE_SCALE

_CENTERS = 4  # largest number of proximal steps at a node
_CUT_ROUNDS = as_runtime_constant(6)  # rounds of tangent cuts at a node with open integers
_CUT_FROM = 1e-5  # violation of a ball from which such a node adds a tangent
_ROUNDING = 1e-14  # relative rounding error of multipliers times rows and bounds


@compiled
def _apply_node_ranges(n: ProblemData, s: SearchState, low: IntArray, high: IntArray) -> None:
    """Enable the rows that a node has, and set the bounds of its entities."""
    rows = s.rows
    for r in range(rows.num_used[0]):
        activation = n.activation[r]
        if activation == ALWAYS:
            continue
        e = n.entity[r]
        decided = low[e] == high[e]
        if activation == DECIDED:
            rows.enabled[r] = decided and low[e] == n.value[r]
        else:
            rows.enabled[r] = not decided
    for e in range(len(n.value_row)):
        r = n.value_row[e]
        if r >= 0:
            rows.lower[r] = (_find_range_end(n.spatial, e, low[e], 0) - s.offset[r]) / n.norm[r]
            rows.upper[r] = (_find_range_end(n.spatial, e, high[e], 1) - s.offset[r]) / n.norm[r]
    if len(n.spatial.first) > 0:
        _update_envelopes(
            n.spatial, low, high, rows.M, rows.T, rows.lower, rows.upper, rows.enabled,
            rows.tolerance, n.norm, s.offset, s.u,
        )  # fmt: skip


@compiled
def _adapt_working_set(n: ProblemData, s: SearchState, w: WorkingSet) -> None:
    """Adapt another node's working set to the node whose rows are in place."""
    _remove_disabled_rows(s.rows, w)
    if len(n.spatial.first) > 0:
        _refactorise(s.rows, w)  # rows of envelopes have changed


@compiled
def _compute_bound(n: ProblemData, s: SearchState, w: WorkingSet) -> tuple[float, float]:
    """Return the bound that multipliers prove, and its loss by the proximal term; set s.w."""
    value = _compute_dual_value(s.rows, w) + s.scalars[CONSTANT]
    k = len(s.u)
    magnitude, length = 0.0, 0.0
    for i in range(k):
        length += w.v[i] * w.v[i]
    length = np.sqrt(length)
    for i in range(w.count[0]):
        edge = _find_right_side(s.rows, w.row[i], w.side[i])
        magnitude += abs(w.multiplier[i]) * (length + (0.0 if np.isinf(edge) else abs(edge)))
    value -= _ROUNDING * magnitude
    for i in range(k - 1, -1, -1):
        total = w.v[i] - s.u[i]
        row = n.U[i]
        for j in range(i + 1, k):
            total -= row[j] * s.w[j]
        s.w[i] = total / row[i]
    loss = 0.0
    for i in range(k):
        if n.eps[i] == 0.0:
            continue
        deviation = s.w[i] - s.center[i]
        pull = n.eps[i] * deviation
        extreme = n.box_upper[i] if pull > 0 else n.box_lower[i]
        loss += 0.5 * n.eps[i] * deviation * deviation + pull * (extreme - s.w[i])
    loss = max(loss, 0.0)
    return value - loss, loss


@compiled
def _evaluate_objective(n: ProblemData, w: Array) -> float:
    """Return the stated cost at w."""
    k = len(w)
    total = n.constant
    for i in range(k):
        if w[i] != 0.0:
            product = 0.0
            row = n.H[i]
            for j in range(k):
                product += row[j] * w[j]
            total += w[i] * (0.5 * product + n.g[i])
    return total


@compiled
def _solve_with_cuts(
    n: ProblemData,
    s: SearchState,
    w: WorkingSet,
    cutoff: float,
    limit: int,
    max_rounds: int,
    tolerance: float,
) -> int:
    """Solve the node's rows, and add the tangents that its balls need."""
    status = SOLVED
    for cut_round in range(max_rounds + 1):
        status = _solve_least_distance(s.rows, w, cutoff, limit)
        if len(n.radius) == 0 or status != SOLVED or cut_round == max_rounds:
            break
        _compute_bound(n, s, w)
        if _add_tangent_cuts(n, s, tolerance) <= 0:
            break
    return status


@compiled
def _shift_proximal_center(n: ProblemData, s: SearchState) -> None:
    """Move the center of the proximal term to s.w, clipped to the box (proximal-point step)."""
    k = len(s.u)
    step = s.scratch[0]
    for i in range(k):
        clipped = min(max(s.w[i], n.box_lower[i]), n.box_upper[i])
        step[i] = n.eps[i] * (clipped - s.center[i])
        if n.eps[i] > 0.0:
            s.center[i] = clipped
    for i in range(k):
        total = step[i]
        for j in range(i):
            total -= n.L[i, j] * step[j]
        step[i] = total / n.L[i, i]
    constant = n.constant
    for i in range(k):
        s.u[i] -= step[i]
        constant += 0.5 * n.eps[i] * s.center[i] ** 2 - 0.5 * s.u[i] ** 2
    s.scalars[CONSTANT] = constant
    m = s.rows.num_used[0]
    shift = s.shift
    for r in range(m):
        shift[r] = 0.0
    for j in range(k):
        if step[j] != 0.0:
            column = s.rows.T[j]
            for r in range(m):
                shift[r] += step[j] * column[r]
    for r in range(m):
        s.base_lower[r] -= shift[r]
        s.base_upper[r] -= shift[r]
        s.offset[r] += n.norm[r] * shift[r]
        s.rows.lower[r] -= shift[r]
        s.rows.upper[r] -= shift[r]


@compiled
def _compute_ray_bound(s: SearchState, w: WorkingSet) -> float:
    """Return the bound that the ray of an infeasible program proves, constant included.

    Where ranges are narrow, gain and pull may both be of the size of rounding errors, and their
    ratio would prove anything: both count with their worst error.
    """
    k = s.rows.M.shape[1]
    pull = s.scratch[1]
    pull[:] = 0.0
    gain, gain_error, pull_error = 0.0, 0.0, 0.0
    for i in range(w.ray_count[0]):
        row, side, weight = w.ray_row[i], w.ray_side[i], w.ray[i]
        if weight < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
            weight = 0.0
        edge = _find_right_side(s.rows, row, side)
        gain -= weight * edge
        gain_error += _ROUNDING * weight * (0.0 if np.isinf(edge) else abs(edge))
        pull_error += _ROUNDING * weight  # rows have norm 1
        for j in range(k):
            pull[j] += weight * side * s.rows.M[row, j]
    gain -= gain_error
    if gain <= 0.0:
        return -np.inf
    square = 0.0
    for j in range(k):
        square += pull[j] * pull[j]
    length = np.sqrt(square) + pull_error
    return 0.5 * gain * gain / max(length * length, 1e-300) + s.scalars[CONSTANT]


@compiled
def _compute_max_proximal(n: ProblemData, s: SearchState) -> float:
    """Return the largest value of the proximal term within the box."""
    total = 0.0
    for i in range(len(n.eps)):
        if n.eps[i] > 0.0:
            width = n.box_upper[i] - n.box_lower[i]
            total += 0.5 * n.eps[i] * width * width
    return total


@compiled
def _compute_closing_value(s: SearchState) -> float:
    """Return a dual value that certainly closes a node, up to which a ray is followed."""
    incumbent_cost = s.scalars[INCUMBENT_COST]
    return (
        1.0
        + abs(s.scalars[CONSTANT])
        + (0.0 if np.isinf(incumbent_cost) else 2.0 * abs(incumbent_cost))
    )


@compiled
def _follow_ray(s: SearchState, w: WorkingSet, dual_value: float) -> None:
    """Move the multipliers of an infeasible program along its ray up to a dual value."""
    value = _compute_dual_value(s.rows, w)
    slope = 0.0
    for i in range(w.ray_count[0]):
        slope -= w.ray[i] * _find_right_side(s.rows, w.ray_row[i], w.ray_side[i])
    step = max(dual_value - value, 0.0) / max(slope, 1e-300)
    count = w.count[0]
    for i in range(w.ray_count[0] - 1):
        w.multiplier[i] += step * w.ray[i]
    last = w.ray_count[0] - 1
    if count < len(w.row):
        w.row[count], w.side[count] = w.ray_row[last], w.ray_side[last]
        w.multiplier[count] = step
        w.active[w.row[count]] = 1
        w.count[0] = count + 1


@compiled
def _solve_relaxation(n: ProblemData, s: SearchState, limit: int) -> tuple[int, float]:
    """Solve the current node in s.main; return status and bound, infinite if it is infeasible."""
    low, high = s.low, s.high
    status, bound = SOLVED, -np.inf
    for proximal_step in range(_CENTERS + 1):
        last = proximal_step == _CENTERS
        cutoff = np.inf if last else _compute_dual_cutoff(s)
        status = _solve_with_cuts(n, s, s.main, cutoff, limit, _CUT_ROUNDS, _CUT_FROM)
        new_bound, loss = _compute_bound(n, s, s.main)
        bound = max(bound, new_bound)
        if status == EMPTY:
            bound = max(bound, _compute_ray_bound(s, s.main) - _compute_max_proximal(n, s))
            break
        allowed = _LOSS * s.scalars[GAP] * max(abs(bound), MIN_OBJECTIVE_SCALE)
        if (
            status == STUCK
            or last
            or bound >= _compute_cutoff(s)
            or (loss <= allowed and status == SOLVED)
        ):
            break
        _shift_proximal_center(n, s)
        _apply_node_ranges(n, s, low, high)
    return status, np.inf if bound > n.max_cost else bound
