"""Nodes of the tree, and what a search keeps beside them.

A node is a range for every integer, its parent's active rows with their multipliers, and a bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.solvers.mixed_integer.compiling import compiled
from climbplan.solvers.mixed_integer.numbers import Numbers
from climbplan.solvers.mixed_integer.working_set import (
    _FAR,
    Rows,
    Working,
    _clear,
    _edge,
    _refactor,
)
from climbplan.solvers.result import LEAST_OBJECTIVE

OPEN, BRANCHED, CLOSED, EMPTY_NODE, LEFT = 0, 1, 2, 3, 4  # what became of a node
DONE, GROW, GROW_ROWS, PAUSE = 0, 1, 2, 3  # why a run ends

# Numbers of a search, by place: the incumbent's cost, the relaxation's constant, least bound of
# what was left, relative gap, largest violation of an incumbent
BEST, CONSTANT, LEFT_BOUND, GAP, FEASIBILITY = 0, 1, 2, 3, 4
# Counts: nodes made, open, processed; the next one of a dive; what was found and what was left
COUNT, HEAP, NODES, NEXT, INCUMBENTS, UNPROVED = 0, 1, 2, 3, 4, 5
# Probed children, guessed incumbents, hints that wait, rounds of tangents at a leaf
PROBES, GUESSES, HINTED, AGAIN = 6, 7, 8, 9
WORK = 10  # dual steps after which no further node is begun
SEEDED = 11  # whether a point waits from which to look for an incumbent
MOST = 10**15  # nodes or dual steps: no limit

_LOSS = 0.05  # share of the gap that the proximal term may cost a bound


class Tree(NamedTuple):
    """All nodes, open and closed."""

    low: NDArray[np.int32]  # (cap, E)
    high: NDArray[np.int32]
    bound: Array  # (cap,)
    state: NDArray[np.int8]  # (cap,)
    depth: NDArray[np.int32]
    row: NDArray[np.int32]  # (cap, K) active rows
    side: NDArray[np.int8]
    multiplier: Array
    active: NDArray[np.int32]  # (cap,) how many
    heap: NDArray[np.int32]  # (cap,) open nodes, least bound first


class Search(NamedTuple):
    """What a search keeps beside its nodes."""

    real: Array
    whole: IntArray
    rows: Rows
    main: Working
    probe: Working
    base_lower: Array  # (m,) bounds of rows at the present centre of the proximal term
    base_upper: Array
    offset: Array  # (m,)
    u: Array  # (k,)
    center: Array  # (k,)
    tangent_to: IntArray  # (m,) the ball that a row is a tangent to, -1
    direction: Array  # (m, D) and where: a of a'(F w + f) <= radius
    w: Array  # (k,)
    best_w: Array  # (k,)
    best_whole: IntArray  # (E,)
    gain: Array  # (2, E) sums of gains by distance, down and up
    seen: IntArray  # (2, E)
    distance: Array  # (2, E) at the node at hand
    low: IntArray  # (E,) the node at hand
    high: IntArray
    hint: IntArray  # (H, E) integers to try first, as many as HINTED
    chosen: IntArray  # (E,) integers that are tried
    seed: Array  # (k,) where SEEDED, with integers of `seed_whole`
    seed_whole: IntArray  # (E,)
    # Scratch
    spare: Array  # (2, k)
    shift: Array  # (m,)
    score: Array  # (E,)
    vector: Array  # (D,)


@compiled
def _cutoff(s: Search) -> float:
    """Bounds from here on are as good as the incumbent."""
    best = s.real[BEST]
    if np.isinf(best):
        return np.inf
    return best - s.real[GAP] * max(abs(best), LEAST_OBJECTIVE)


@compiled
def _slack_cutoff(s: Search) -> float:
    """A dual value of nodes that surely reaches the cutoff, proximal term included."""
    cutoff = _cutoff(s)
    if np.isinf(cutoff):
        return np.inf
    return cutoff - s.real[CONSTANT] + _LOSS * s.real[GAP] * max(abs(cutoff), LEAST_OBJECTIVE)


@compiled
def _push(tree: Tree, whole: IntArray, node: int) -> None:
    heap, at = tree.heap, whole[HEAP]
    whole[HEAP] += 1
    heap[at] = node
    while at > 0:
        above = (at - 1) // 2
        if tree.bound[heap[above]] <= tree.bound[heap[at]]:
            break
        heap[above], heap[at] = heap[at], heap[above]
        at = above


@compiled
def _pop(tree: Tree, whole: IntArray) -> int:
    heap = tree.heap
    top = heap[0]
    whole[HEAP] -= 1
    count = whole[HEAP]
    heap[0] = heap[count]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= count:
            break
        if child + 1 < count and tree.bound[heap[child + 1]] < tree.bound[heap[child]]:
            child += 1
        if tree.bound[heap[at]] <= tree.bound[heap[child]]:
            break
        heap[at], heap[child] = heap[child], heap[at]
        at = child
    return top


@compiled
def _store(tree: Tree, node: int, w: Working) -> None:
    """Active rows and multipliers for whoever starts from this node."""
    count = w.count[0]
    tree.active[node] = count
    for i in range(count):
        tree.row[node, i] = w.row[i]
        tree.side[node, i] = np.int8(w.side[i])
        tree.multiplier[node, i] = w.multiplier[i]


@compiled
def _load(s: Search, tree: Tree, node: int) -> None:
    """A node's active rows into s.main, with fresh factors; s.rows must be the node's."""
    w = s.main
    _clear(w)
    count = 0
    for i in range(tree.active[node]):
        row, side = tree.row[node, i], float(tree.side[node, i])
        multiplier = tree.multiplier[node, i]
        if s.rows.on[row] == 0 or abs(_edge(s.rows, row, side)) > _FAR:
            continue
        if multiplier < 0.0 and s.rows.lower[row] < s.rows.upper[row]:
            multiplier = 0.0
        w.row[count], w.side[count], w.multiplier[count] = row, side, multiplier
        count += 1
    w.count[0] = count
    _refactor(s.rows, w)


@compiled
def _child(
    n: Numbers, s: Search, tree: Tree, node: int, e: int, up: int, split: int, bound: float
) -> int:
    """A new node; active rows have to be stored by the caller."""
    new = s.whole[COUNT]
    s.whole[COUNT] += 1
    for f in range(len(n.column)):
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
def _close(s: Search, tree: Tree, node: int, bound: float) -> None:
    tree.bound[node] = max(tree.bound[node], bound)
    tree.state[node] = CLOSED if not np.isinf(bound) else EMPTY_NODE
    if not np.isinf(bound):
        s.real[LEFT_BOUND] = min(s.real[LEFT_BOUND], tree.bound[node])
