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
from climbplan.bookshelf.exact.branching import estimate_gains, select_branch
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.problem import LEAN_FROM, LEAN_LEFT, LEAN_RIGHT, X0, SceneArrays
from climbplan.bookshelf.exact.qp import SOLVED
from climbplan.bookshelf.exact.relaxation import (
    evaluate_turn_cost,
    select_cheapest_state,
    solve_relaxation,
)
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
    PlacementTree,
    copy_node,
    pop,
    push,
    release_node,
)
from climbplan.bookshelf.exact.workspace import STATE_GAIN, TILT, TILT_GAIN, NodeWorkspace, X

FINISHED, PAUSED, FULL = 0, 1, 2

_STEPS = 12  # trust-region steps
_FIRST_RADIUS, _LAST_RADIUS = 0.15, 2e-4  # [rad]
_LYING = 1e-6  # [rad] tilts this near to the horizontal become horizontal


@compiled
def _compute_cutoff(
    problem: SceneArrays, tree: PlacementTree, absolute: float, relative: float
) -> float:
    """Compute the cutoff: nodes with a larger bound are fathomed."""
    cost = tree.best[COST]
    if cost < np.inf:
        return cost - max(absolute, relative * cost)
    return problem.cost_limit


@compiled
def _record_if_new(tree: PlacementTree, slot: int, mask: IntArray) -> bool:
    """Record an assignment of states; returns whether it is new."""
    key = slot + 1
    for k in range(len(mask)):
        for state in range(4):
            if mask[k] == 1 << state:
                key = 4 * key + state
    place = (key * 2654435761) % TRIED
    for _ in range(32):
        if tree.assignments[place] == key:
            return False
        if tree.assignments[place] == 0:
            tree.assignments[place] = key
            return True
        place = (place + 1) % TRIED
    return False


@compiled
def _improve_placement(
    problem: SceneArrays,
    work: NodeWorkspace,
    tree: PlacementTree,
    slot: int,
    mask: IntArray,
    tilt: Array,
    steps: int,
    accuracy: float,
) -> None:
    """Improve the placement with these states and tilts by trust-region steps on the tilts."""
    n, book = problem.stored, problem.book
    span, trial = np.empty(2 * n), np.empty(n)
    for k in range(n):
        trial[k] = tilt[k]
    cost, bound, radius = np.inf, -np.inf, _FIRST_RADIUS
    for step in range(steps + 1):
        for k in range(n):
            span[k] = span[n + k] = trial[k]
        tree.counters[PLACEMENTS] += 1
        status, _ = solve_relaxation(problem, work, slot, mask, span, np.inf)
        placement_cost = np.inf
        if status == SOLVED:
            placement_cost = 0.0
            for k in range(n):
                displacement = work.body[k, X] - book[k, X0]
                placement_cost += displacement * displacement
                placement_cost += evaluate_turn_cost(problem, k, work.body[k, 2], work.body[k, 3])
        if placement_cost < tree.best[COST]:
            tree.best[COST] = placement_cost
            tree.best_mask[n] = mask[n]
            for k in range(n):
                tree.best_mask[k] = mask[k]
                tree.best[PLACE + k], tree.best[PLACE + n + k] = work.body[k, X], trial[k]
            tree.counters[BEST_SLOT] = slot
        if placement_cost < cost:
            if cost - placement_cost < 0.3 * (cost - bound):
                radius *= 0.5
            cost = placement_cost
            for k in range(n):
                tilt[k] = trial[k]
        elif step > 0:
            radius *= 0.3
        if step == steps or radius < _LAST_RADIUS:
            return
        for k in range(n):
            span[k] = max(tilt[k] - radius, book[k, LEAN_FROM])
            span[n + k] = min(tilt[k] + radius, math.pi / 2)
        target = min(cost, tree.best[COST], problem.cost_limit) - accuracy
        status, bound = solve_relaxation(problem, work, slot, mask, span, target)
        if status != SOLVED or bound > target:
            return
        for k in range(n):
            trial[k] = work.body[k, TILT]
            if trial[k] > math.pi / 2 - _LYING:
                trial[k] = math.pi / 2


@compiled
def _evaluate_node(
    problem: SceneArrays,
    work: NodeWorkspace,
    tree: PlacementTree,
    node: int,
    absolute: float,
    relative: float,
) -> bool:
    """Bound a node and dive from it; returns whether it stays open."""
    n = problem.stored
    tree.counters[NODES] += 1
    slot, mask = tree.integers[node, SLOT], tree.integers[node, MASK:]
    span = tree.reals[node, SPAN:]
    cutoff = _compute_cutoff(problem, tree, absolute, relative)
    _, bound = solve_relaxation(problem, work, slot, mask, span, cutoff)
    bound = max(bound, tree.reals[node, BOUND])
    tree.reals[node, BOUND] = bound
    if bound > cutoff:
        return False
    estimate_gains(problem, work, mask)
    branch = select_branch(problem, work, mask)
    tree.integers[node, BRANCH] = branch

    # Each assignment of states is tried once, and again where the estimated gain is small.
    assignment, tilt = np.empty(n + 1, np.int64), np.empty(n)
    has_lean, missing = False, 0.0
    assignment[n] = mask[n]
    for k in range(n):
        tilt[k] = work.body[k, TILT]
        missing += work.body[k, STATE_GAIN] + work.body[k, TILT_GAIN]
        assignment[k] = 1 << select_cheapest_state(problem, k, mask[k])
        has_lean = has_lean or assignment[k] == 1 << LEAN_LEFT or assignment[k] == 1 << LEAN_RIGHT
    is_new = _record_if_new(tree, slot, assignment)
    if is_new or (has_lean and missing < 0.5 * (tree.best[COST] - bound)):
        accuracy = 0.1 * max(absolute, relative * min(tree.best[COST], problem.cost_limit))
        steps = _STEPS if has_lean else 0
        _improve_placement(problem, work, tree, slot, assignment, tilt, steps, accuracy)
    return branch >= 0 and bound <= _compute_cutoff(problem, tree, absolute, relative)


@compiled
def expand_nodes(
    problem: SceneArrays,
    work: NodeWorkspace,
    tree: PlacementTree,
    absolute: float,
    relative: float,
    steps: int,
) -> int:
    """Split up to `steps` nodes; returns FINISHED, PAUSED (nodes are open) or FULL (no memory)."""
    n, counters = problem.stored, tree.counters
    for _ in range(steps):
        if counters[OPEN] == 0:
            return FINISHED
        if counters[UNUSED] < 4:
            return FULL
        node = pop(tree)
        bound, branch = tree.reals[node, BOUND], tree.integers[node, BRANCH]
        if bound > _compute_cutoff(problem, tree, absolute, relative):
            tree.best[CLOSED] = min(tree.best[CLOSED], bound)
            release_node(tree, node)
            continue
        book = branch - n if branch >= n else branch
        for child_index in range(1 if branch == ROOT else 2 if branch >= n else 4):
            if 0 <= branch < n and not tree.integers[node, MASK + book] >> child_index & 1:
                continue
            child = copy_node(tree, node)
            if branch >= n:
                low, high = SPAN + book, SPAN + n + book
                middle = 0.5 * (tree.reals[node, low] + tree.reals[node, high])
                tree.reals[child, high if child_index == 0 else low] = middle
            elif branch >= 0:
                tree.integers[child, MASK + book] = 1 << child_index
            if _evaluate_node(problem, work, tree, child, absolute, relative):
                push(tree, child)
            else:
                tree.best[CLOSED] = min(tree.best[CLOSED], tree.reals[child, BOUND])
                release_node(tree, child)
        release_node(tree, node)
    return PAUSED if counters[OPEN] > 0 else FINISHED
