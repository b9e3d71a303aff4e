"""Select the integer or factor at which a node is split.

Selection uses pseudo-costs, initialised by strong branching with a few dual steps in both children
(reliability branching: Achterberg, Koch and Martin 2005). A child that these steps close is a leaf.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import EMPTY, _solve_least_distance
from climbplan.solvers.mixed_integer.bounds import (
    _adapt_working_set,
    _apply_node_ranges,
    _compute_bound,
    _compute_closing_value,
    _compute_max_proximal,
    _compute_ray_bound,
    _follow_ray,
)
from climbplan.solvers.mixed_integer.compiling import as_runtime_constant, compiled
from climbplan.solvers.mixed_integer.nodes import (
    BRANCHED,
    FEASIBILITY,
    INCUMBENT_COST,
    MAX_DUAL_STEPS,
    NUM_OPEN,
    NUM_PROBES,
    UNLIMITED,
    NodeTree,
    SearchState,
    _close_node,
    _compute_cutoff,
    _compute_dual_cutoff,
    _create_child,
    _push_open,
    _store_working_set,
)
from climbplan.solvers.mixed_integer.problem_data import ProblemData
from climbplan.solvers.mixed_integer.spatial import _choose_cell_split
from climbplan.solvers.mixed_integer.working_set import WorkingSet, _copy_working_set

_PROBE_ITERATIONS = as_runtime_constant(25)
_RELIABLE = 4  # branchings after which an integer's pseudo-costs are reliable
_PROBED = 8  # largest number of integers probed at a node
_INTEGRAL = 1e-6  # integrality tolerance of columns
_SPACE = 0.1  # least gain rate of a factor, as a fraction of the average
_STAY = 0.5  # a dive continues up to this fraction between the least open bound and the cutoff


@compiled
def _measure_infeasibility(
    n: ProblemData, s: SearchState, w: WorkingSet, low: IntArray, high: IntArray
) -> int:
    """Measure how far each undecided entity is from either branch; return how many are open."""
    open_count = 0
    slack = s.scalars[FEASIBILITY]
    for e in range(len(n.value_row)):
        s.distance[0, e] = s.distance[1, e] = 0.0
        if low[e] == high[e] or n.spatial.cell_width[e] > 0.0:
            continue
        r = n.value_row[e]
        if r >= 0:
            value = n.norm[r] * w.value[r] + s.offset[r]
            down = value - np.floor(value)
            up = 1.0 - down
            if min(down, up) <= _INTEGRAL:
                down = up = 0.0
            s.distance[0, e], s.distance[1, e] = down, up
        else:
            for k in range(n.indicator_start[e], n.indicator_start[e + 1]):
                r = n.indicator_rows[k]
                excess_upper = w.value[r] - s.base_upper[r]
                excess_lower = s.base_lower[r] - w.value[r]
                worst = max(excess_upper, excess_lower) * n.norm[r]
                if worst > slack:
                    branch = n.value[r]
                    s.distance[branch, e] = max(s.distance[branch, e], worst * n.inverse_big_m[r])
        if s.distance[0, e] > 0.0 and s.distance[1, e] > 0.0:
            open_count += 1
    if open_count == 0 and len(n.spatial.first) > 0:  # integers first, as they activate rows
        open_count = _measure_products(n, s, w, low, high)
    return open_count


@compiled
def _evaluate_entity(
    n: ProblemData, s: SearchState, w: WorkingSet, e: int, low: IntArray, high: IntArray
) -> float:
    """Return the value of an integer with a column, or of a factor, at a relaxation's solution."""
    if low[e] == high[e] and n.spatial.cell_width[e] == 0.0:
        return float(low[e])
    r = n.value_row[e]
    return n.norm[r] * w.value[r] + s.offset[r]


@compiled
def _is_product_enforced(
    n: ProblemData, s: SearchState, w: WorkingSet, q: int, low: IntArray, high: IntArray
) -> bool:
    """Return whether a row with the product is active, or would be if no integer were split."""
    p = n.spatial
    if p.is_unconditional[q]:
        return True
    for k in range(p.indicator_start[q], p.indicator_start[q + 1]):
        e = p.entity[k]
        if low[e] == high[e]:
            value = low[e]
        elif n.value_row[e] >= 0:
            value = np.int64(np.round(_evaluate_entity(n, s, w, e, low, high)))
        else:
            value = 1 if s.distance[1, e] == 0.0 else 0
        if value == p.value[k]:
            return True
    return False


@compiled
def _measure_products(
    n: ProblemData, s: SearchState, w: WorkingSet, low: IntArray, high: IntArray
) -> int:
    """Measure factors of violated products; return the number of products that are violated."""
    p, open_count = n.spatial, 0
    for q in range(len(p.first)):
        if not _is_product_enforced(n, s, w, q, low, high):
            continue
        i, j, r = p.first[q], p.second[q], p.product_row[q]
        x, y = _evaluate_entity(n, s, w, i, low, high), _evaluate_entity(n, s, w, j, low, high)
        error = abs(n.norm[r] * w.value[r] + s.offset[r] - x * y)
        if error * p.weight[q] <= s.scalars[FEASIBILITY]:
            continue
        can_split = False
        for factor in range(2):
            e = i if factor == 0 else j
            if low[e] < high[e]:
                score = min(error / p.max_gap[q], 1.0)
                if p.cell_width[e] > 0.0:  # wide ranges promise the largest gain
                    score *= (high[e] - low[e] + 1.0) / (n.root_high[e] - n.root_low[e] + 1.0)
                s.distance[0, e] = max(s.distance[0, e], score)
                s.distance[1, e] = max(s.distance[1, e], score)
                can_split = True
        open_count += 1 if can_split else 0
    return open_count


@compiled
def _choose_split(n: ProblemData, s: SearchState, e: int) -> int:
    """Return the largest value of the lower child."""
    r = n.value_row[e]
    if r < 0:
        return 0
    if n.spatial.cell_width[e] > 0.0:
        factor_value = n.norm[r] * s.main.value[r] + s.offset[r]
        return _choose_cell_split(n.spatial, e, factor_value, s.low[e], s.high[e])
    value = np.int64(np.floor(n.norm[r] * s.main.value[r] + s.offset[r]))
    return min(max(value, s.low[e]), s.high[e] - 1)


@compiled
def _probe_child(n: ProblemData, s: SearchState, e: int, up: int, split: int) -> float:
    """Return the bound of a child after a few dual steps."""
    low, high = s.low[e], s.high[e]
    if up:
        s.low[e] = split + 1
    else:
        s.high[e] = split
    _copy_working_set(s.main, s.probe)
    _apply_node_ranges(n, s, s.low, s.high)
    _adapt_working_set(n, s, s.probe)
    s.counters[NUM_PROBES] += 1
    status = _solve_least_distance(s.rows, s.probe, _compute_dual_cutoff(s), _PROBE_ITERATIONS)
    bound, _ = _compute_bound(n, s, s.probe)
    if status == EMPTY:
        bound = max(bound, _compute_ray_bound(s, s.probe) - _compute_max_proximal(n, s))
        if bound >= _compute_cutoff(s):
            _follow_ray(s, s.probe, _compute_closing_value(s))
        if bound > n.max_cost:
            bound = np.inf
    s.low[e], s.high[e] = low, high
    return bound


@compiled
def _score_gains(down: float, up: float) -> float:
    """Return the product score of the gains of both children."""
    return max(down, 1e-9) * max(up, 1e-9)


@compiled
def _estimate_gain(n: ProblemData, s: SearchState, e: int, up: int, average: float) -> float:
    """Estimate the gain of a child by pseudo-costs."""
    rate = s.gain_sum[up, e] / s.num_gains[up, e] if s.num_gains[up, e] > 0 else average
    if n.spatial.cell_width[e] > 0.0:
        rate = max(rate, _SPACE * average)
    return rate * s.distance[up, e]


@compiled
def _strong_branch(
    n: ProblemData, s: SearchState, tree: NodeTree, node: int, e: int, up: int, split: int
) -> tuple[float, bool]:
    """Probe a child and update its pseudo-cost; return its bound and whether it was closed."""
    parent = tree.bound[node]
    child_bound = max(parent, _probe_child(n, s, e, up, split))
    gain = child_bound - parent
    if not np.isinf(gain):
        s.gain_sum[up, e] += gain / s.distance[up, e]
        s.num_gains[up, e] += 1
    if child_bound < _compute_cutoff(s):
        return child_bound, False
    # The child is closed, and keeps the multipliers that do it
    new = _create_child(n, s, tree, node, e, up, split, child_bound)
    _store_working_set(tree, new, s.probe)
    _close_node(s, tree, new, child_bound)
    return child_bound, True


@compiled
def _select_best_score(s: SearchState) -> int:
    """Return the integer of largest score."""
    selected = 0
    for e in range(1, len(s.score)):
        if s.score[e] > s.score[selected]:
            selected = e
    return selected


@compiled
def _branch_node(n: ProblemData, s: SearchState, tree: NodeTree, node: int) -> int:
    """Split a node; return the child with which the dive continues, or -1."""
    E = len(n.value_row)
    parent = tree.bound[node]
    total, num_averaged = 0.0, 0
    for up in range(2):
        for e in range(E):
            if s.num_gains[up, e] > 0:
                total += s.gain_sum[up, e] / s.num_gains[up, e]
                num_averaged += 1
    average = total / num_averaged if num_averaged > 0 else 1.0
    # Rank by pseudo-costs: the best reliable integer competes with the first few that are probed
    best, chosen = -1.0, 0
    for e in range(E):
        s.score[e] = -1.0
        if s.distance[0, e] > 0.0 and s.distance[1, e] > 0.0:
            gain_down = _estimate_gain(n, s, e, 0, average)
            gain_up = _estimate_gain(n, s, e, 1, average)
            score = _score_gains(gain_down, gain_up)
            if min(s.num_gains[0, e], s.num_gains[1, e]) < _RELIABLE:
                s.score[e] = score
            elif score > best:
                best, chosen = score, e
    below, above = parent, parent  # bounds of the children
    below_closed, above_closed = False, False  # whether probes have closed the children
    max_probes = _PROBED
    if np.isinf(s.scalars[INCUMBENT_COST]) and s.counters[MAX_DUAL_STEPS] < UNLIMITED:
        # The budget of dual steps is best spent on a dive: without an incumbent nothing is closed
        max_probes = 0
        e = _select_best_score(s)
        if s.score[e] > best:
            chosen = e
    for _ in range(max_probes):
        e = _select_best_score(s)
        if s.score[e] < 0.0:
            break
        s.score[e] = -1.0
        split = _choose_split(n, s, e)
        bound_down, bound_up = parent, parent
        for up in range(2):
            child_bound, closed = _strong_branch(n, s, tree, node, e, up, split)
            if up == 0:
                bound_down, below_closed = child_bound, closed
            else:
                bound_up, above_closed = child_bound, closed
        closed = below_closed or above_closed
        score_probed = np.inf if closed else _score_gains(bound_down - parent, bound_up - parent)
        if score_probed > best:
            best, chosen = score_probed, e
            below, above = bound_down, bound_up
        if closed:
            break
    split = _choose_split(n, s, chosen)
    tree.state[node] = BRANCHED
    prefer = 0 if s.distance[0, chosen] < s.distance[1, chosen] else 1
    if below != above:
        prefer = 0 if below < above else 1
    follow = -1
    for child_order in range(2):
        up = prefer if child_order == 0 else 1 - prefer
        if above_closed if up else below_closed:
            continue
        new = _create_child(n, s, tree, node, chosen, up, split, above if up else below)
        _store_working_set(tree, new, s.main)
        if follow < 0:
            follow = new
        else:
            _push_open(tree, s.counters, new)
    if follow >= 0 and not np.isinf(s.scalars[INCUMBENT_COST]) and s.counters[NUM_OPEN] > 0:
        cutoff, least_open_bound = _compute_cutoff(s), tree.bound[tree.heap[0]]
        if tree.bound[follow] > least_open_bound + _STAY * max(cutoff - least_open_bound, 0.0):
            _push_open(tree, s.counters, follow)
            follow = -1
    return follow
