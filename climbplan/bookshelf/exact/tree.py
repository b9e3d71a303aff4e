"""The open nodes of the branch and bound, the best placement so far, and the roots.

A node is a slot and a state of the inserted book, a set of states for every stored book and an
interval of tilts for those that have a single lean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.problem import (
    ALLOWED,
    FLAT,
    HEIGHT,
    LEAN_FROM,
    UPRIGHT,
    WIDTH,
    SceneArrays,
)

# Columns of `PlacementTree.integers` and `.reals`; the masks and the tilt intervals follow
SLOT, BRANCH, DEPTH, MASK = 0, 1, 2, 3
BOUND, SPAN = 0, 1
# Columns of `PlacementTree.pool`
HEAP, FREE = 0, 1
# Entries of `PlacementTree.counters`
OPEN, UNUSED, NODES, PLACEMENTS, BEST_SLOT = range(5)
# Entries of `PlacementTree.best`; centres and tilts (n each) follow
COST, CLOSED, PLACE = 0, 1, 2

ROOT = -2  # branch of a node that was not relaxed yet
TRIED = 1 << 14  # assignments remembered
_DEEPER = 1e-6  # [mm^2] a level: among equal bounds the deeper node is opened first


class PlacementTree(NamedTuple):
    """Open nodes and the incumbent."""

    integers: IntArray  # (capacity, 3 + n + 1) by node
    reals: Array  # (capacity, 1 + 2 n) by node
    pool: IntArray  # (capacity, 2) heap of open nodes and list of unused ones
    counters: IntArray  # (5,)
    assignments: IntArray  # keys of assignments
    best: Array  # cost; least bound of a closed node not shown empty; centres, tilts
    best_mask: IntArray  # (n + 1,)


def create_tree(n: int, capacity: int) -> PlacementTree:
    """Create an empty tree for scenes of n stored books; `grow_tree` enlarges it."""
    return PlacementTree(
        integers=np.zeros((capacity, MASK + n + 1), np.int64),
        reals=np.zeros((capacity, SPAN + 2 * n)),
        pool=np.zeros((capacity, 2), np.int64),
        counters=np.zeros(5, np.int64),
        assignments=np.zeros(TRIED, np.int64),
        best=np.zeros(PLACE + 2 * n),
        best_mask=np.zeros(n + 1, np.int64),
    )


def grow_tree(tree: PlacementTree) -> PlacementTree:
    """Return the same tree with twice the capacity."""
    old, unused = len(tree.pool), int(tree.counters[UNUSED])
    integers, reals, pool = (
        np.concatenate([array, np.zeros_like(array)])
        for array in (tree.integers, tree.reals, tree.pool)
    )
    pool[unused : unused + old, FREE] = np.arange(old, 2 * old)
    tree.counters[UNUSED] = unused + old
    return tree._replace(integers=integers, reals=reals, pool=pool)


def insert_roots(problem: SceneArrays, tree: PlacementTree) -> None:
    """Empty the tree and insert the roots: slots and states of the inserted book."""
    n, capacity = problem.stored, len(tree.pool)
    tree.counters[:] = 0
    tree.counters[UNUSED] = capacity
    tree.pool[:, FREE] = np.arange(capacity - 1, -1, -1)
    tree.assignments[:] = 0
    tree.best[COST] = tree.best[CLOSED] = np.inf
    mask = problem.book[:, ALLOWED].astype(np.int64)
    for state in (UPRIGHT, FLAT):
        if int(problem.book[n, ALLOWED]) >> state & 1:
            mask[n] = 1 << state
            _push_roots(problem, tree, mask, 0)


def insert_side_by_side_roots(problem: SceneArrays, tree: PlacementTree) -> None:
    """Insert nodes that place all books side by side in their narrowest states.

    They are feasible in nearly all feasible scenes. The tree covers them already; as duplicates
    with a larger depth they are opened first.
    """
    book = problem.book
    fits = book[:, ALLOWED].astype(np.int64)
    flat = np.where(fits & 1 << FLAT, book[:, HEIGHT], np.inf)
    upright = np.where(fits & 1 << UPRIGHT, book[:, WIDTH], np.inf)
    _push_roots(problem, tree, 1 << np.where(upright <= flat, UPRIGHT, FLAT), 1 << 30)


def _push_roots(problem: SceneArrays, tree: PlacementTree, mask: IntArray, depth: int) -> None:
    """Push one node for each slot with these states."""
    n = problem.stored
    for slot in range(n + 1):
        tree.counters[UNUSED] -= 1
        node = tree.pool[tree.counters[UNUSED], FREE]
        tree.integers[node, :MASK] = slot, ROOT, depth
        tree.integers[node, MASK:] = mask
        tree.reals[node, BOUND] = 0.0
        tree.reals[node, SPAN : SPAN + n] = problem.book[:n, LEAN_FROM]
        tree.reals[node, SPAN + n :] = math.pi / 2
        push(tree, node)


def compute_lower_bound(tree: PlacementTree) -> float:
    """Compute the lower bound of the tree: no placement costs less [mm^2]."""
    open_nodes = tree.pool[: tree.counters[OPEN], HEAP]
    bounds = tree.reals[open_nodes, BOUND]
    return float(min(tree.best[COST], tree.best[CLOSED], *bounds))


@compiled
def _compute_priority(tree: PlacementTree, node: int) -> float:
    return tree.reals[node, BOUND] - _DEEPER * tree.integers[node, DEPTH]


@compiled
def push(tree: PlacementTree, node: int) -> None:
    """Put a node on the heap."""
    pool, place, key = tree.pool, tree.counters[OPEN], _compute_priority(tree, node)
    tree.counters[OPEN] += 1
    while place > 0:
        parent = (place - 1) // 2
        if key >= _compute_priority(tree, pool[parent, HEAP]):
            break
        pool[place, HEAP] = pool[parent, HEAP]
        place = parent
    pool[place, HEAP] = node


@compiled
def pop(tree: PlacementTree) -> int:
    pool = tree.pool
    first = pool[0, HEAP]
    tree.counters[OPEN] -= 1
    size = tree.counters[OPEN]
    node = pool[size, HEAP]
    key, place = _compute_priority(tree, node), 0
    while True:
        child = 2 * place + 1
        if child >= size:
            break
        if child + 1 < size and _compute_priority(tree, pool[child + 1, HEAP]) < _compute_priority(
            tree, pool[child, HEAP]
        ):
            child += 1
        if _compute_priority(tree, pool[child, HEAP]) >= key:
            break
        pool[place, HEAP] = pool[child, HEAP]
        place = child
    pool[place, HEAP] = node
    return first


@compiled
def copy_node(tree: PlacementTree, node: int) -> int:
    """Copy a node into a new one that is one level deeper."""
    tree.counters[UNUSED] -= 1
    child = tree.pool[tree.counters[UNUSED], FREE]
    for k in range(tree.integers.shape[1]):
        tree.integers[child, k] = tree.integers[node, k]
    for k in range(tree.reals.shape[1]):
        tree.reals[child, k] = tree.reals[node, k]
    tree.integers[child, DEPTH] += 1
    return child


@compiled
def release_node(tree: PlacementTree, node: int) -> None:
    tree.pool[tree.counters[UNUSED], FREE] = node
    tree.counters[UNUSED] += 1
