"""Best-first branch and bound over states and tilts, with dives for incumbents.

The roots are all slots and states of the inserted book. A node is split by the state of a book (one
child a state) or by halving a tilt interval. Every assignment of states met on the way is tried
once as a whole: the placement that keeps tilts where they are is made exact and then improved on
trust regions, whose step is the relaxed placement of a small box.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from climbplan.bookshelf.compiled import compiled
from climbplan.bookshelf.exact_gains import choose, find_gains
from climbplan.bookshelf.exact_problem import (
    ALLOWED,
    FLAT,
    HEIGHT,
    LEAN_FROM,
    LEAN_LEFT,
    LEAN_RIGHT,
    UPRIGHT,
    WIDTH,
    X0,
    Problem,
)
from climbplan.bookshelf.exact_qp import SOLVED
from climbplan.bookshelf.exact_relax import cheapest_state, relax, turn_cost
from climbplan.bookshelf.exact_rows import STATE_GAIN, TILT, TILT_GAIN, Sheet, Whole, X
from climbplan.bookshelf.scene import Array

FINISHED, PAUSED, FULL = 0, 1, 2

# Columns of `Tree.whole` and `Tree.real`; the masks and the tilt intervals follow
SLOT, BRANCH, DEPTH, MASK = 0, 1, 2, 3
BOUND, SPAN = 0, 1
# Columns of `Tree.pool`
HEAP, FREE = 0, 1
# Entries of `Tree.tally`
OPEN, UNUSED, NODES, PLACEMENTS, BEST_SLOT = range(5)
# Entries of `Tree.best`; centres and tilts (n each) follow
COST, CLOSED, PLACE = 0, 1, 2

_ROOT = -2  # branch of a node that was not relaxed yet
_TRIED = 1 << 14  # assignments remembered
_STEPS = 12  # trust-region steps
_FIRST_RADIUS, _LAST_RADIUS = 0.15, 2e-4  # [rad]
_LYING = 1e-6  # [rad] tilts this near to the horizontal become horizontal
_DEEPER = 1e-6  # [mm^2] a level: among equal bounds the deeper node is opened first


class Tree(NamedTuple):
    """Open nodes and the incumbent."""

    whole: Whole  # (capacity, 3 + n + 1) by node
    real: Array  # (capacity, 1 + 2 n) by node
    pool: Whole  # (capacity, 2) heap of open nodes and list of unused ones
    tally: Whole  # (5,)
    tried: Whole  # keys of assignments
    best: Array  # cost; least bound of a closed node not shown empty; centres, tilts
    best_mask: Whole  # (n + 1,)


def new_tree(n: int, capacity: int) -> Tree:
    """Room for trees on scenes of n stored books; it grows when needed."""
    return Tree(
        whole=np.zeros((capacity, MASK + n + 1), np.int64),
        real=np.zeros((capacity, SPAN + 2 * n)),
        pool=np.zeros((capacity, 2), np.int64),
        tally=np.zeros(5, np.int64),
        tried=np.zeros(_TRIED, np.int64),
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


def _push_roots(problem: Problem, tree: Tree, mask: Whole, depth: int) -> None:
    """One node a slot with these states."""
    n = problem.stored
    for slot in range(n + 1):
        tree.tally[UNUSED] -= 1
        node = tree.pool[tree.tally[UNUSED], FREE]
        tree.whole[node, :MASK] = slot, _ROOT, depth
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
def _pop(tree: Tree) -> int:
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
def _copy(tree: Tree, node: int) -> int:
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
def _free(tree: Tree, node: int) -> None:
    tree.pool[tree.tally[UNUSED], FREE] = node
    tree.tally[UNUSED] += 1


@compiled
def _cutoff(problem: Problem, tree: Tree, absolute: float, relative: float) -> float:
    """Nodes whose bound exceeds this need not be opened."""
    cost = tree.best[COST]
    if cost < np.inf:
        return cost - max(absolute, relative * cost)
    return problem.ceiling


@compiled
def _is_new(tree: Tree, slot: int, mask: Whole) -> bool:
    """Whether an assignment of states is met for the first time; notes that it was."""
    key = slot + 1
    for k in range(len(mask)):
        for state in range(4):
            if mask[k] == 1 << state:
                key = 4 * key + state
    place = (key * 2654435761) % _TRIED
    for _ in range(32):
        if tree.tried[place] == key:
            return False
        if tree.tried[place] == 0:
            tree.tried[place] = key
            return True
        place = (place + 1) % _TRIED
    return False


@compiled
def _improve(
    problem: Problem,
    sheet: Sheet,
    tree: Tree,
    slot: int,
    mask: Whole,
    tilt: Array,
    steps: int,
    accuracy: float,
) -> None:
    """Best placement with these states and tilts, and trust-region steps on the tilts from it."""
    n, book = problem.stored, problem.book
    span, trial = np.empty(2 * n), np.empty(n)
    for k in range(n):
        trial[k] = tilt[k]
    cost, bound, radius = np.inf, -np.inf, _FIRST_RADIUS
    for step in range(steps + 1):
        for k in range(n):
            span[k] = span[n + k] = trial[k]
        tree.tally[PLACEMENTS] += 1
        status, _ = relax(problem, sheet, slot, mask, span, np.inf)
        here = np.inf
        if status == SOLVED:
            here = 0.0
            for k in range(n):
                moved = sheet.seat[k, X] - book[k, X0]
                here += moved * moved
                here += turn_cost(problem, k, sheet.seat[k, 2], sheet.seat[k, 3])
        if here < tree.best[COST]:
            tree.best[COST] = here
            tree.best_mask[n] = mask[n]
            for k in range(n):
                tree.best_mask[k] = mask[k]
                tree.best[PLACE + k], tree.best[PLACE + n + k] = sheet.seat[k, X], trial[k]
            tree.tally[BEST_SLOT] = slot
        if here < cost:
            if cost - here < 0.3 * (cost - bound):
                radius *= 0.5
            cost = here
            for k in range(n):
                tilt[k] = trial[k]
        elif step > 0:
            radius *= 0.3
        if step == steps or radius < _LAST_RADIUS:
            return
        for k in range(n):
            span[k] = max(tilt[k] - radius, book[k, LEAN_FROM])
            span[n + k] = min(tilt[k] + radius, math.pi / 2)
        target = min(cost, tree.best[COST], problem.ceiling) - accuracy
        status, bound = relax(problem, sheet, slot, mask, span, target)
        if status != SOLVED or bound > target:
            return
        for k in range(n):
            trial[k] = sheet.seat[k, TILT]
            if trial[k] > math.pi / 2 - _LYING:
                trial[k] = math.pi / 2


@compiled
def _open(
    problem: Problem,
    sheet: Sheet,
    tree: Tree,
    node: int,
    absolute: float,
    relative: float,
) -> bool:
    """Bound a node and dive from it; whether it is worth keeping."""
    n = problem.stored
    tree.tally[NODES] += 1
    slot, mask = tree.whole[node, SLOT], tree.whole[node, MASK:]
    span = tree.real[node, SPAN:]
    cutoff = _cutoff(problem, tree, absolute, relative)
    _, bound = relax(problem, sheet, slot, mask, span, cutoff)
    bound = max(bound, tree.real[node, BOUND])
    tree.real[node, BOUND] = bound
    if bound > cutoff:
        return False
    find_gains(problem, sheet, mask)
    branch = choose(problem, sheet, mask)
    tree.whole[node, BRANCH] = branch

    # Each assignment of states is tried once, and again where little seems to be missing.
    whole, tilt = np.empty(n + 1, np.int64), np.empty(n)
    leaning, missing = False, 0.0
    whole[n] = mask[n]
    for k in range(n):
        tilt[k] = sheet.seat[k, TILT]
        missing += sheet.seat[k, STATE_GAIN] + sheet.seat[k, TILT_GAIN]
        whole[k] = 1 << cheapest_state(problem, k, mask[k])
        leaning = leaning or whole[k] == 1 << LEAN_LEFT or whole[k] == 1 << LEAN_RIGHT
    new = _is_new(tree, slot, whole)
    if new or (leaning and missing < 0.5 * (tree.best[COST] - bound)):
        accuracy = 0.1 * max(absolute, relative * min(tree.best[COST], problem.ceiling))
        steps = _STEPS if leaning else 0
        _improve(problem, sheet, tree, slot, whole, tilt, steps, accuracy)
    return branch >= 0 and bound <= _cutoff(problem, tree, absolute, relative)


@compiled
def advance(
    problem: Problem, sheet: Sheet, tree: Tree, absolute: float, relative: float, steps: int
) -> int:
    """Split up to `steps` nodes; returns FINISHED, PAUSED (more to do) or FULL (no room)."""
    n, tally = problem.stored, tree.tally
    for _ in range(steps):
        if tally[OPEN] == 0:
            return FINISHED
        if tally[UNUSED] < 4:
            return FULL
        node = _pop(tree)
        bound, branch = tree.real[node, BOUND], tree.whole[node, BRANCH]
        if bound > _cutoff(problem, tree, absolute, relative):
            tree.best[CLOSED] = min(tree.best[CLOSED], bound)
            _free(tree, node)
            continue
        book = branch - n if branch >= n else branch
        for part in range(1 if branch == _ROOT else 2 if branch >= n else 4):
            if 0 <= branch < n and not tree.whole[node, MASK + book] >> part & 1:
                continue
            child = _copy(tree, node)
            if branch >= n:
                low, high = SPAN + book, SPAN + n + book
                middle = 0.5 * (tree.real[node, low] + tree.real[node, high])
                tree.real[child, high if part == 0 else low] = middle
            elif branch >= 0:
                tree.whole[child, MASK + book] = 1 << part
            if _open(problem, sheet, tree, child, absolute, relative):
                push(tree, child)
            else:
                tree.best[CLOSED] = min(tree.best[CLOSED], tree.real[child, BOUND])
                _free(tree, child)
        _free(tree, node)
    return PAUSED if tally[OPEN] > 0 else FINISHED
