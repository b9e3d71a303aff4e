"""Best-first branch and bound over states and tilts, with dives for incumbents.

The roots are all slots and states of the inserted book. A node is split by the state of a book (one
child a state) or by halving a tilt interval. Every assignment of states met on the way is tried
once as a whole: the placement that keeps tilts where they are is made exact and then improved on
trust regions, whose step is the relaxed placement of a small box.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.gains import choose, find_gains
from climbplan.bookshelf.exact.problem import LEAN_FROM, LEAN_LEFT, LEAN_RIGHT, X0, Problem
from climbplan.bookshelf.exact.qp import SOLVED
from climbplan.bookshelf.exact.relaxation import cheapest_state, relax, turn_cost
from climbplan.bookshelf.exact.sheet import STATE_GAIN, TILT, TILT_GAIN, Sheet, X
from climbplan.bookshelf.exact.tree import (
    BEST_SLOT,
    BOUND,
    BRANCH,
    CLOSED,
    COST,
    MASK,
    NODES,
    OPEN,
    PLACE,
    PLACEMENTS,
    ROOT,
    SLOT,
    SPAN,
    TRIED,
    UNUSED,
    Tree,
    copied,
    discard,
    pop,
    push,
)

FINISHED, PAUSED, FULL = 0, 1, 2

_STEPS = 12  # trust-region steps
_FIRST_RADIUS, _LAST_RADIUS = 0.15, 2e-4  # [rad]
_LYING = 1e-6  # [rad] tilts this near to the horizontal become horizontal


@compiled
def _cutoff(problem: Problem, tree: Tree, absolute: float, relative: float) -> float:
    """Nodes whose bound exceeds this need not be opened."""
    cost = tree.best[COST]
    if cost < np.inf:
        return cost - max(absolute, relative * cost)
    return problem.ceiling


@compiled
def _is_new(tree: Tree, slot: int, mask: IntArray) -> bool:
    """Whether an assignment of states is met for the first time; notes that it was."""
    key = slot + 1
    for k in range(len(mask)):
        for state in range(4):
            if mask[k] == 1 << state:
                key = 4 * key + state
    place = (key * 2654435761) % TRIED
    for _ in range(32):
        if tree.tried[place] == key:
            return False
        if tree.tried[place] == 0:
            tree.tried[place] = key
            return True
        place = (place + 1) % TRIED
    return False


@compiled
def _improve(
    problem: Problem,
    sheet: Sheet,
    tree: Tree,
    slot: int,
    mask: IntArray,
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
        node = pop(tree)
        bound, branch = tree.real[node, BOUND], tree.whole[node, BRANCH]
        if bound > _cutoff(problem, tree, absolute, relative):
            tree.best[CLOSED] = min(tree.best[CLOSED], bound)
            discard(tree, node)
            continue
        book = branch - n if branch >= n else branch
        for part in range(1 if branch == ROOT else 2 if branch >= n else 4):
            if 0 <= branch < n and not tree.whole[node, MASK + book] >> part & 1:
                continue
            child = copied(tree, node)
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
                discard(tree, child)
        discard(tree, node)
    return PAUSED if tally[OPEN] > 0 else FINISHED
