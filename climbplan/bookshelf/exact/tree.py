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
    Problem,
)

# Columns of `Tree.whole` and `Tree.real`; the masks and the tilt intervals follow
SLOT, BRANCH, DEPTH, MASK = 0, 1, 2, 3
BOUND, SPAN = 0, 1
# Columns of `Tree.pool`
HEAP, FREE = 0, 1
# Entries of `Tree.tally`
OPEN, UNUSED, NODES, PLACEMENTS, BEST_SLOT = range(5)
# Entries of `Tree.best`; centres and tilts (n each) follow
COST, CLOSED, PLACE = 0, 1, 2

ROOT = -2  # branch of a node that was not relaxed yet
TRIED = 1 << 14  # assignments remembered
_DEEPER = 1e-6  # [mm^2] a level: among equal bounds the deeper node is opened first


class Tree(NamedTuple):
    """Open nodes and the incumbent."""

    whole: IntArray  # (capacity, 3 + n + 1) by node
    real: Array  # (capacity, 1 + 2 n) by node
    pool: IntArray  # (capacity, 2) heap of open nodes and list of unused ones
    tally: IntArray  # (5,)
    tried: IntArray  # keys of assignments
    best: Array  # cost; least bound of a closed node not shown empty; centres, tilts
    best_mask: IntArray  # (n + 1,)


def new_tree(n: int, capacity: int) -> Tree:
    """Room for trees on scenes of n stored books; it grows when needed."""
    return Tree(
        whole=np.zeros((capacity, MASK + n + 1), np.int64),
        real=np.zeros((capacity, SPAN + 2 * n)),
        pool=np.zeros((capacity, 2), np.int64),
        tally=np.zeros(5, np.int64),
        tried=np.zeros(TRIED, np.int64),
        best=np.zeros(PLACE + 2 * n),
        best_mask=np.zeros(n + 1, np.int64),
    )


def grown(tree: Tree) -> Tree:
    """The same tree with room for twice as many nodes."""
    old, unused = len(tree.pool), int(tree.tally[UNUSED])
    whole, real, pool = (
        np.concatenate([array, np.zeros_like(array)])
        for array in (tree.whole, tree.real, tree.pool)
    )
    pool[unused : unused + old, FREE] = np.arange(old, 2 * old)
    tree.tally[UNUSED] = unused + old
    return tree._replace(whole=whole, real=real, pool=pool)


def plant(problem: Problem, tree: Tree) -> None:
    """Empty the tree and put in the roots: slots and states of the inserted book."""
    n, capacity = problem.stored, len(tree.pool)
    tree.tally[:] = 0
    tree.tally[UNUSED] = capacity
    tree.pool[:, FREE] = np.arange(capacity - 1, -1, -1)
    tree.tried[:] = 0
    tree.best[COST] = tree.best[CLOSED] = np.inf
    mask = problem.book[:, ALLOWED].astype(np.int64)
    for state in (UPRIGHT, FLAT):
        if int(problem.book[n, ALLOWED]) >> state & 1:
            mask[n] = 1 << state
            _push_roots(problem, tree, mask, 0)


def offer_narrow(problem: Problem, tree: Tree) -> None:
    """Add nodes that place all books side by side where they are narrowest: if anything fits, this
    nearly always does. The tree covers them already; they come first in it now."""
    book = problem.book
    fits = book[:, ALLOWED].astype(np.int64)
    flat = np.where(fits & 1 << FLAT, book[:, HEIGHT], np.inf)
    upright = np.where(fits & 1 << UPRIGHT, book[:, WIDTH], np.inf)
    _push_roots(problem, tree, 1 << np.where(upright <= flat, UPRIGHT, FLAT), 1 << 30)


def _push_roots(problem: Problem, tree: Tree, mask: IntArray, depth: int) -> None:
    """One node a slot with these states."""
    n = problem.stored
    for slot in range(n + 1):
        tree.tally[UNUSED] -= 1
        node = tree.pool[tree.tally[UNUSED], FREE]
        tree.whole[node, :MASK] = slot, ROOT, depth
        tree.whole[node, MASK:] = mask
        tree.real[node, BOUND] = 0.0
        tree.real[node, SPAN : SPAN + n] = problem.book[:n, LEAN_FROM]
        tree.real[node, SPAN + n :] = math.pi / 2
        push(tree, node)


def least_bound(tree: Tree) -> float:
    """No placement costs less."""
    open_nodes = tree.pool[: tree.tally[OPEN], HEAP]
    bounds = tree.real[open_nodes, BOUND]
    return float(min(tree.best[COST], tree.best[CLOSED], *bounds))


@compiled
def _key(tree: Tree, node: int) -> float:
    return tree.real[node, BOUND] - _DEEPER * tree.whole[node, DEPTH]


@compiled
def push(tree: Tree, node: int) -> None:
    """Put a node on the heap."""
    pool, place, key = tree.pool, tree.tally[OPEN], _key(tree, node)
    tree.tally[OPEN] += 1
    while place > 0:
        parent = (place - 1) // 2
        if key >= _key(tree, pool[parent, HEAP]):
            break
        pool[place, HEAP] = pool[parent, HEAP]
        place = parent
    pool[place, HEAP] = node


@compiled
def pop(tree: Tree) -> int:
    pool = tree.pool
    first = pool[0, HEAP]
    tree.tally[OPEN] -= 1
    size = tree.tally[OPEN]
    node = pool[size, HEAP]
    key, place = _key(tree, node), 0
    while True:
        child = 2 * place + 1
        if child >= size:
            break
        if child + 1 < size and _key(tree, pool[child + 1, HEAP]) < _key(tree, pool[child, HEAP]):
            child += 1
        if _key(tree, pool[child, HEAP]) >= key:
            break
        pool[place, HEAP] = pool[child, HEAP]
        place = child
    pool[place, HEAP] = node
    return first


@compiled
def copied(tree: Tree, node: int) -> int:
    """A new node, one level deeper, that is otherwise the same."""
    tree.tally[UNUSED] -= 1
    child = tree.pool[tree.tally[UNUSED], FREE]
    for k in range(tree.whole.shape[1]):
        tree.whole[child, k] = tree.whole[node, k]
    for k in range(tree.real.shape[1]):
        tree.real[child, k] = tree.real[node, k]
    tree.whole[child, DEPTH] += 1
    return child


@compiled
def discard(tree: Tree, node: int) -> None:
    tree.pool[tree.tally[UNUSED], FREE] = node
    tree.tally[UNUSED] += 1
