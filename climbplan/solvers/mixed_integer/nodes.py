"""Nodes of the tree, and the state that a search keeps in addition to them.

A node is a range for every integer, its parent's active rows with their multipliers, and a bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.problem_data import ProblemData
from climbplan.solvers.mixed_integer.working_set import (
    _FAR,
    WorkingSet,
    WorkingSetRows,
    _clear_working_set,
    _find_right_side,
    _refactorise,
)
from climbplan.solvers.result import MIN_OBJECTIVE_SCALE

OPEN, BRANCHED, CLOSED, EMPTY_NODE, GIVEN_UP = 0, 1, 2, 3, 4  # state of a node
DONE, GROW, GROW_ROWS, PAUSE = 0, 1, 2, 3  # reason why a run ends

# Indices into `Search.scalars`: cost of the incumbent, constant of the relaxation, least bound of
# closed nodes, relative gap, largest violation of an incumbent, cost that counts as zero
INCUMBENT_COST, CONSTANT, CLOSED_BOUND, GAP, FEASIBILITY, ZERO_COST = 0, 1, 2, 3, 4, 5
# Indices into `Search.counters`: nodes created, open and processed, next node of a dive (-1 for
# none), incumbents found, leaves neither solved nor proved infeasible
NUM_NODES, NUM_OPEN, NUM_PROCESSED, DIVE_NODE, NUM_INCUMBENTS, NUM_UNPROVED = 0, 1, 2, 3, 4, 5
# Probed children, programs solved with fixed integers, waiting proposals, cut rounds at a leaf
NUM_PROBES, NUM_FIXED_SOLVES, NUM_PROPOSALS, CUT_ROUNDS = 6, 7, 8, 9
MAX_DUAL_STEPS = 10  # dual steps after which no further node is begun
HAS_START = 11  # whether there is a point from which to start a local search
UNLIMITED = 10**15  # of nodes or dual steps: no limit

_LOSS = 0.05  # fraction of the gap by which the proximal term may weaken a bound


class NodeTree(NamedTuple):
    """All nodes, open and closed."""

    low: NDArray[np.int32]  # (cap, E)
    high: NDArray[np.int32]
    bound: Array  # (cap,)
    state: NDArray[np.int8]  # (cap,)
    depth: NDArray[np.int32]
    row: NDArray[np.int32]  # (cap, K) active rows
    side: NDArray[np.int8]
    multiplier: Array
    active: NDArray[np.int32]  # (cap,) number of active rows
    heap: NDArray[np.int32]  # (cap,) open nodes as a binary heap, least bound first


class SearchState(NamedTuple):
    """State of a search in addition to its nodes."""

    scalars: Array  # (8,) see the indices above
    counters: IntArray  # (12,)
    rows: WorkingSetRows
    main: WorkingSet
    probe: WorkingSet
    base_lower: Array  # (m,) bounds of rows at the current center of the proximal term
    base_upper: Array
    offset: Array  # (m,)
    u: Array  # (k,)
    center: Array  # (k,)
    tangent_to: IntArray  # (m,) ball to which a row is a tangent, -1 for none
    direction: Array  # (m, D) normal a of the tangent a'(F w + f) <= radius
    w: Array  # (k,)
    best_w: Array  # (k,)
    best_integers: IntArray  # (E,)
    gain_sum: Array  # (2, E) pseudo-costs: sums of gains by distance, down and up
    num_gains: IntArray  # (2, E) number of gains in each sum
    distance: Array  # (2, E) infeasibility of each branch at the current node
    low: IntArray  # (E,) range of the current node
    high: IntArray
    proposals: IntArray  # (H, E) integers to try first, of which NUM_PROPOSALS wait
    trial_integers: IntArray  # (E,) integers that are tried
    start_w: Array  # (k,) start of a local search if HAS_START
    start_integers: IntArray  # (E,)
    # Scratch
    scratch: Array  # (2, k)
    shift: Array  # (m,)
    score: Array  # (E,)
    vector: Array  # (D,)


@compiled
def _compute_cutoff(s: SearchState) -> float:
    """Return the bound from which a node cannot improve the incumbent by more than the gap."""
    incumbent_cost = s.scalars[INCUMBENT_COST]
    if np.isinf(incumbent_cost):
        return np.inf
    margin = s.scalars[GAP] * abs(incumbent_cost)
    if abs(incumbent_cost) <= s.scalars[ZERO_COST]:
        margin = max(margin, s.scalars[ZERO_COST])
    return incumbent_cost - margin


@compiled
def _compute_dual_cutoff(s: SearchState) -> float:
    """Return a dual value of nodes that surely reaches the cutoff, proximal term included."""
    cutoff = _compute_cutoff(s)
    if np.isinf(cutoff):
        return np.inf
    return (
        cutoff
        - s.scalars[CONSTANT]
        + _LOSS * s.scalars[GAP] * max(abs(cutoff), MIN_OBJECTIVE_SCALE)
    )


@compiled
def _push_open(tree: NodeTree, counters: IntArray, node: int) -> None:
    """Push a node onto the heap of open nodes."""
    heap, position = tree.heap, counters[NUM_OPEN]
    counters[NUM_OPEN] += 1
    heap[position] = node
    while position > 0:
        parent = (position - 1) // 2
        if tree.bound[heap[parent]] <= tree.bound[heap[position]]:
            break
        heap[parent], heap[position] = heap[position], heap[parent]
        position = parent


@compiled
def _pop_open(tree: NodeTree, counters: IntArray) -> int:
    """Pop the open node of least bound."""
    heap = tree.heap
    top = heap[0]
    counters[NUM_OPEN] -= 1
    count = counters[NUM_OPEN]
    heap[0] = heap[count]
    position = 0
    while True:
        child = 2 * position + 1
        if child >= count:
            break
        if child + 1 < count and tree.bound[heap[child + 1]] < tree.bound[heap[child]]:
            child += 1
        if tree.bound[heap[position]] <= tree.bound[heap[child]]:
            break
        heap[position], heap[child] = heap[child], heap[position]
        position = child
    return top


@compiled
def _store_working_set(tree: NodeTree, node: int, w: WorkingSet) -> None:
    """Store active rows and multipliers with a node, as a warm start for its children."""
    count = w.count[0]
    tree.active[node] = count
    for i in range(count):
        tree.row[node, i] = w.row[i]
        tree.side[node, i] = np.int8(w.side[i])
        tree.multiplier[node, i] = w.multiplier[i]


@compiled
def _load_working_set(s: SearchState, tree: NodeTree, node: int) -> None:
    """Load a node's active rows into s.main and factorise; s.rows must be those of the node."""
    w = s.main
    _clear_working_set(w)
    count = 0
    for i in range(tree.active[node]):
        row, side = tree.row[node, i], float(tree.side[node, i])
        multiplier = tree.multiplier[node, i]
        if s.rows.enabled[row] == 0 or abs(_find_right_side(s.rows, row, side)) > _FAR:
            continue
        if multiplier < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
            multiplier = 0.0
        w.row[count], w.side[count], w.multiplier[count] = row, side, multiplier
        count += 1
    w.count[0] = count
    _refactorise(s.rows, w)


@compiled
def _create_child(
    n: ProblemData,
    s: SearchState,
    tree: NodeTree,
    node: int,
    e: int,
    up: int,
    split: int,
    bound: float,
) -> int:
    """Create a child; the caller has to store its active rows."""
    new = s.counters[NUM_NODES]
    s.counters[NUM_NODES] += 1
    for f in range(len(n.value_row)):
        tree.low[new, f], tree.high[new, f] = s.low[f], s.high[f]
    if up:
        tree.low[new, e] = split + 1
    else:
        tree.high[new, e] = split
    tree.bound[new] = bound
    tree.depth[new] = tree.depth[node] + 1
    tree.state[new] = OPEN
    return new


@compiled
def _close_node(s: SearchState, tree: NodeTree, node: int, bound: float) -> None:
    """Close a node at a bound; an infinite bound marks it as infeasible."""
    tree.bound[node] = max(tree.bound[node], bound)
    tree.state[node] = CLOSED if not np.isinf(bound) else EMPTY_NODE
    if not np.isinf(bound):
        s.scalars[CLOSED_BOUND] = min(s.scalars[CLOSED_BOUND], tree.bound[node])
