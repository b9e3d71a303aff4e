"""Process the nodes of the tree in compiled code, in an order between depth first and best first.

The search dives until it has an incumbent. Afterwards it continues with a child while that may
still be the best open node, else with the open node of least bound.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.solvers.mixed_integer.active_set import CUT_OFF, EMPTY, SOLVED, STUCK
from climbplan.solvers.mixed_integer.bounds import (
    _adapt_working_set,
    _apply_node_ranges,
    _compute_bound,
    _compute_closing_value,
    _follow_ray,
    _solve_relaxation,
)
from climbplan.solvers.mixed_integer.branching import (
    _branch_node,
    _measure_infeasibility,
)
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.incumbents import (
    _CLOSE_ROUNDS,
    _accept_integral_node,
    _round_relaxation,
    _solve_fixed_integers,
)
from climbplan.solvers.mixed_integer.nodes import (
    BRANCHED,
    CLOSED_BOUND,
    CONSTANT,
    CUT_ROUNDS,
    DIVE_NODE,
    DONE,
    EMPTY_NODE,
    FEASIBILITY,
    GIVEN_UP,
    GROW,
    GROW_ROWS,
    HAS_START,
    INCUMBENT_COST,
    MAX_DUAL_STEPS,
    NUM_NODES,
    NUM_OPEN,
    NUM_PROCESSED,
    NUM_PROPOSALS,
    NUM_UNPROVED,
    OPEN,
    PAUSE,
    NodeTree,
    SearchState,
    _close_node,
    _compute_cutoff,
    _create_child,
    _load_working_set,
    _pop_open,
    _push_open,
    _store_working_set,
)
from climbplan.solvers.mixed_integer.problem_data import ProblemData
from climbplan.solvers.mixed_integer.tangent_cuts import _add_tangent_cuts, _max_ball_violation
from climbplan.solvers.mixed_integer.working_set import _FAR, _clear_working_set, _find_right_side

_ITERATIONS = 400  # dual steps of one re-solve; one more for each column
_CUT_SHARE = 80  # spare rows for tangents that a node must find, for each ball
_EVERY = 8  # nodes between rounding heuristics once there is an incumbent


@compiled
def _split_unsolved(n: ProblemData, s: SearchState, tree: NodeTree, node: int) -> None:
    """Split a node that was neither solved nor proved infeasible, or give it up with its bound."""
    selected = -1
    for e in range(len(n.value_row)):
        if s.low[e] < s.high[e]:
            selected = e
            break
    if selected < 0:
        s.counters[NUM_UNPROVED] += 1
        tree.state[node] = GIVEN_UP
        s.scalars[CLOSED_BOUND] = min(s.scalars[CLOSED_BOUND], tree.bound[node])
        return
    split = (s.low[selected] + s.high[selected]) // 2
    for up in range(2):
        new = _create_child(n, s, tree, node, selected, up, split, tree.bound[node])
        _store_working_set(tree, new, s.main)
        _push_open(tree, s.counters, new)
    tree.state[node] = BRANCHED


@compiled
def _process_node(n: ProblemData, s: SearchState, tree: NodeTree, node: int, warm: bool) -> int:
    """Process one node; return the child with which the dive continues, or -1."""
    E = len(n.value_row)
    for e in range(E):
        s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
    _apply_node_ranges(n, s, s.low, s.high)
    if warm:
        _adapt_working_set(n, s, s.main)
    else:
        _load_working_set(s, tree, node)
    limit = _ITERATIONS + len(s.u)
    status, bound = STUCK, -np.inf
    for attempt in range(2):
        status, new_bound = _solve_relaxation(n, s, limit if attempt == 0 else 4 * limit)
        bound = max(bound, new_bound)
        if status in (SOLVED, CUT_OFF) or bound >= _compute_cutoff(s) or s.rows.stop[0]:
            break
        _clear_working_set(s.main)  # the factors have lost accuracy: solve from scratch
    if s.rows.stop[0] and not bound >= _compute_cutoff(s):
        # Stopped: the node is open again, with the bound that multipliers prove so far
        if bound > tree.bound[node]:
            tree.bound[node] = bound
            _store_working_set(tree, node, s.main)
        _push_open(tree, s.counters, node)
        return -1
    tree.bound[node] = max(tree.bound[node], bound)
    if status == EMPTY and bound >= _compute_cutoff(s):
        # A ray closes the node: multipliers moved along it prove the bound later, too
        _follow_ray(s, s.main, _compute_closing_value(s))
        _store_working_set(tree, node, s.main)
        _close_node(s, tree, node, bound)
        return -1
    _store_working_set(tree, node, s.main)
    if tree.bound[node] >= _compute_cutoff(s):
        _close_node(s, tree, node, tree.bound[node])
        return -1
    if status != SOLVED:
        _split_unsolved(n, s, tree, node)
        return -1
    leaf = _measure_infeasibility(n, s, s.main, s.low, s.high) == 0
    if leaf and _max_ball_violation(n, s) > s.scalars[FEASIBILITY]:
        # The point must satisfy the balls before it can be an incumbent
        if (
            _add_tangent_cuts(n, s, s.scalars[FEASIBILITY]) > 0
            and s.counters[CUT_ROUNDS] < _CLOSE_ROUNDS
        ):
            s.counters[CUT_ROUNDS] += 1
            return node
        _split_unsolved(n, s, tree, node)
        return -1
    s.counters[CUT_ROUNDS] = 0
    if len(n.spatial.first) > 0:
        return _finish_product_node(n, s, tree, node, leaf)
    tries_incumbent = np.isinf(s.scalars[INCUMBENT_COST]) or s.counters[NUM_PROCESSED] % _EVERY == 1
    if leaf:
        tries_incumbent = _accept_integral_node(n, s, s.trial_integers)
    elif s.counters[NUM_PROPOSALS]:
        for i in range(s.counters[NUM_PROPOSALS]):
            for e in range(E):
                s.trial_integers[e] = s.proposals[i, e]
            _solve_fixed_integers(n, s, s.trial_integers, limit)
        s.counters[NUM_PROPOSALS] = 0
        tries_incumbent = False
        _apply_node_ranges(n, s, s.low, s.high)
    elif tries_incumbent:
        _round_relaxation(n, s, s.low, s.high, s.trial_integers)
    if tries_incumbent:
        _solve_fixed_integers(n, s, s.trial_integers, limit)
        _apply_node_ranges(n, s, s.low, s.high)
    if leaf or tree.bound[node] >= _compute_cutoff(s):
        _close_node(s, tree, node, tree.bound[node])
        return -1
    return _branch_node(n, s, tree, node)


@compiled
def _finish_product_node(
    n: ProblemData, s: SearchState, tree: NodeTree, node: int, leaf: bool
) -> int:
    """Finish a node with products; its caller runs the local search for incumbents."""
    if leaf and _accept_integral_node(n, s, s.trial_integers):
        _split_unsolved(n, s, tree, node)  # an integer has an integral value, but is not fixed
        return -1
    if not leaf:
        _round_relaxation(n, s, s.low, s.high, s.start_integers)
        for j in range(len(s.w)):
            s.start_w[j] = s.w[j]
        s.counters[HAS_START] = 1
    if leaf or tree.bound[node] >= _compute_cutoff(s):
        _close_node(s, tree, node, tree.bound[node])
        return -1
    return _branch_node(n, s, tree, node)


@compiled
def run_search(n: ProblemData, s: SearchState, tree: NodeTree, nodes: int, max_nodes: int) -> int:
    """Process up to `nodes` nodes, `most` in all; return DONE, GROW, GROW_ROWS or PAUSE.

    GROW and GROW_ROWS ask for larger arrays. DONE also follows the limit of dual steps, and a stop
    requested by another thread; open nodes stay open.
    """
    counters = s.counters
    capacity = len(tree.bound) - 4
    for _ in range(nodes):
        if s.rows.stop[0]:
            return DONE
        if counters[NUM_NODES] >= capacity:
            return GROW
        if len(n.radius) > 0 and s.rows.num_used[0] + _CUT_SHARE * len(n.radius) >= len(
            n.activation
        ):
            return GROW_ROWS
        node, is_dive = counters[DIVE_NODE], True
        counters[DIVE_NODE] = -1
        if node < 0:
            is_dive = False
            if counters[NUM_OPEN] == 0:
                return DONE
            node = _pop_open(tree, counters)
        if tree.bound[node] >= _compute_cutoff(s):
            _close_node(s, tree, node, tree.bound[node])
            continue
        if (
            counters[NUM_PROCESSED] >= max_nodes
            or s.main.iterations[0] + s.probe.iterations[0] >= counters[MAX_DUAL_STEPS]
        ):
            _push_open(tree, counters, node)
            return DONE
        counters[NUM_PROCESSED] += 1
        counters[DIVE_NODE] = _process_node(n, s, tree, node, is_dive)
    return PAUSE


@compiled
def resolve_leaf(n: ProblemData, s: SearchState, tree: NodeTree, node: int) -> None:
    """Solve a leaf again, for multipliers that prove its bound.

    Children that a probe closed late, or that were never processed, have their parent's
    multipliers.
    """
    for e in range(len(n.value_row)):
        s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
    _apply_node_ranges(n, s, s.low, s.high)
    _load_working_set(s, tree, node)
    status, bound = _solve_relaxation(n, s, 4 * (_ITERATIONS + len(s.u)))
    if status == EMPTY:
        tree.state[node] = EMPTY_NODE
    if status != STUCK or bound > tree.bound[node]:  # the bound is proved even when stuck
        tree.bound[node] = bound
        _store_working_set(tree, node, s.main)


@compiled
def rebuild_bounds(n: ProblemData, s: SearchState, tree: NodeTree) -> None:
    """Compute the bounds of a tree's first nodes from multipliers of another problem."""
    w = s.main
    for node in range(s.counters[NUM_NODES]):
        for e in range(len(n.value_row)):
            s.low[e], s.high[e] = tree.low[node, e], tree.high[node, e]
        _apply_node_ranges(n, s, s.low, s.high)
        _clear_working_set(w)
        count = 0
        for i in range(tree.active[node]):
            row, side = tree.row[node, i], float(tree.side[node, i])
            multiplier = tree.multiplier[node, i]
            if s.rows.enabled[row] == 0 or abs(_find_right_side(s.rows, row, side)) > _FAR:
                continue
            if multiplier < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
                continue
            w.row[count], w.side[count], w.multiplier[count] = row, side, multiplier
            count += 1
        w.count[0] = count
        bound, _ = _compute_bound(n, s, w)
        if not bound > s.scalars[CONSTANT]:
            # Multipliers along a ray that proves nothing here are worse than none
            for i in range(tree.active[node]):
                tree.multiplier[node, i] = 0.0
            for i in range(count):
                w.multiplier[i] = 0.0
            bound, _ = _compute_bound(n, s, w)
        tree.bound[node] = bound
        tree.state[node] = OPEN
        w.count[0] = 0
        _push_open(tree, s.counters, node)


@compiled
def round_relaxation(
    n: ProblemData, s: SearchState, low: IntArray, high: IntArray, integers: IntArray
) -> None:
    """Round the relaxation that was solved last, of a node with this range."""
    _measure_infeasibility(n, s, s.main, low, high)
    _round_relaxation(n, s, low, high, integers)
