"""Branching rule: estimate the bound's increase for each decision and select the largest.

A node's relaxed solution is completed: undecided books take their cheapest state and tilts stay
the same. Some rows are violated by the completion, or their exact form costs more by the row's
multiplier. They show which decisions the relaxation avoids. The rule does not affect the validity
of bounds.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.contact import bound_contact_distance
from climbplan.bookshelf.exact.pairs import bound_pair_separation, fill_angle_box
from climbplan.bookshelf.exact.problem import (
    BEST_TILT,
    FLAT,
    HEIGHT,
    STATE_COST,
    UPRIGHT,
    WIDTH,
    SceneArrays,
    select_side,
)
from climbplan.bookshelf.exact.relaxation import (
    bound_turn_cost,
    evaluate_turn_cost,
    select_cheapest_state,
)
from climbplan.bookshelf.exact.workspace import (
    ALONE,
    APART,
    APART_BY_INSERTED,
    BOX,
    COLUMN,
    FIRST,
    KIND,
    LEFT,
    LEFT_BY_INSERTED,
    MIDDLE,
    MULTIPLIER,
    NUMBER,
    ORDER,
    POINT,
    POINT_SIDE,
    RHS,
    RIGHT,
    RIGHT_BY_INSERTED,
    SECOND,
    SIDE,
    STATE,
    STATE_GAIN,
    TILT,
    TILT_GAIN,
    TOUCH,
    NodeWorkspace,
    X,
)

_TILT_SHARE = 2.0  # halving makes two nodes of one, splitting by state up to four
_NARROW = 1e-7  # [rad] intervals are not halved below this


@compiled
def estimate_gains(problem: SceneArrays, work: NodeWorkspace, mask: IntArray) -> None:
    """Estimate the gains of all decisions for the node that was last relaxed.

    The estimate of a row is allocated to its undecided books. Without any it is allocated to its
    leaning books in proportion to the squares of their intervals.
    """
    n, body, role = problem.stored, work.body, work.role
    for k in range(n + 1):
        body[k, STATE_GAIN] = body[k, TILT_GAIN] = 0.0
        _build_completion(problem, work, mask, k)
        if role[k, COLUMN] >= 0:
            # What the Lagrangian falls short of by the book's turn cost.
            price = 0.0
            for r in range(work.rows[0]):
                price += work.side[r, MULTIPLIER] * work.C[r, role[k, COLUMN]]
            exact = evaluate_turn_cost(problem, k, body[k, POINT + 2], body[k, POINT + 3])
            exact -= price * (body[k, TILT] - body[k, MIDDLE])
            body[k, TILT_GAIN] = max(0.0, exact - bound_turn_cost(problem, body[k], k, price))
    for r in range(work.rows[0]):
        kind, i, j = work.side[r, KIND], work.pair[r, FIRST], work.pair[r, SECOND]
        if kind == BOX or kind == ALONE or kind == ORDER:
            continue
        slack, value = -work.side[r, RHS], work.side[r, NUMBER]
        sign = 1.0 if kind >= TOUCH else -1.0
        for k in range(n):
            slack += work.C[r, k] * body[k, X]
            if role[k, COLUMN] >= 0:
                term = work.C[r, role[k, COLUMN]] * (body[k, TILT] - body[k, MIDDLE])
                slack += term
                value += sign * term
        more = max(0.0, sign * (value - _evaluate_exact_bound(problem, body, kind, i, j)))
        short = max(0.0, more - max(0.0, slack))
        _allocate_gain(problem, work, i, j, work.side[r, MULTIPLIER] * more + 0.5 * short * short)
    _find_missing_contacts(problem, work)


@compiled
def _build_completion(problem: SceneArrays, work: NodeWorkspace, mask: IntArray, k: int) -> None:
    """Build side and tilt of a book in the completion."""
    n, body, book = problem.stored, work.body, problem.book
    body[k, POINT_SIDE] = body[k, SIDE]
    if work.role[k, STATE] >= 0:
        tilt = body[k, TILT] if work.role[k, COLUMN] >= 0 else body[k, MIDDLE]
        fill_angle_box(tilt, tilt, body[k, POINT : POINT + 7])
        return
    state = select_cheapest_state(problem, k, mask[k])
    body[k, POINT_SIDE] = select_side(state)
    tilt = book[k, BEST_TILT]
    if state == FLAT:
        tilt = math.pi / 2
    elif state == UPRIGHT:
        tilt = 0.0
    fill_angle_box(tilt, tilt, body[k, POINT : POINT + 7])
    if k < n:
        min_state_cost = np.inf
        for allowed in range(4):
            if mask[k] >> allowed & 1:
                min_state_cost = min(min_state_cost, book[k, STATE_COST + allowed])
        cost = evaluate_turn_cost(problem, k, body[k, POINT + 2], body[k, POINT + 3])
        body[k, STATE_GAIN] = max(0.0, cost - min_state_cost)


@compiled
def _allocate_gain(problem: SceneArrays, work: NodeWorkspace, i: int, j: int, gain: float) -> None:
    n, body, role = problem.stored, work.body, work.role
    undecided, total = 0, 0.0
    for k in range(n):
        if k == i or k == j:
            if role[k, STATE] < 0:
                undecided += 1
            elif role[k, COLUMN] >= 0:
                total += body[k, 6] ** 2
    for k in range(n):
        if k == i or k == j:
            if undecided > 0:
                if role[k, STATE] < 0:
                    body[k, STATE_GAIN] += gain / undecided
            elif role[k, COLUMN] >= 0:
                body[k, TILT_GAIN] += gain * body[k, 6] ** 2 / total


@compiled
def _compute_separation(problem: SceneArrays, body: Array, i: int, j: int) -> float:
    """Compute D of two books in the completion."""
    book = problem.book
    return bound_pair_separation(
        body[i, POINT_SIDE], book[i, WIDTH], book[i, HEIGHT], body[i, POINT : POINT + 7],
        body[j, POINT_SIDE], book[j, WIDTH], book[j, HEIGHT], body[j, POINT : POINT + 7],
        0.0, problem.depth,
    )[0]  # fmt: skip


@compiled
def _compute_contact_distance(problem: SceneArrays, body: Array, i: int, j: int) -> float:
    """Compute U of two books in the completion."""
    book = problem.book
    return bound_contact_distance(
        body[i, POINT_SIDE], book[i, WIDTH], book[i, HEIGHT], body[i, POINT : POINT + 7],
        body[j, POINT_SIDE], book[j, WIDTH], book[j, HEIGHT], body[j, POINT : POINT + 7],
        problem.book_gap,
    )[0]  # fmt: skip


@compiled
def _compute_half_width(problem: SceneArrays, body: Array, k: int) -> float:
    """Compute e of a book in the completion."""
    book = problem.book[k]
    return 0.5 * (book[HEIGHT] * body[k, POINT + 2] + book[WIDTH] * body[k, POINT + 3])


@compiled
def _evaluate_exact_bound(problem: SceneArrays, body: Array, kind: float, i: int, j: int) -> float:
    """Evaluate D, U or e of a row exactly for the completion."""
    n = problem.stored
    if kind == APART:
        return _compute_separation(problem, body, i, j)
    if kind == TOUCH:
        return _compute_contact_distance(problem, body, i, j)
    if kind == LEFT or kind == RIGHT or kind > TOUCH:
        return _compute_half_width(problem, body, min(i, j))
    total = 0.0
    if kind == APART_BY_INSERTED or kind == RIGHT_BY_INSERTED:
        total += _compute_separation(problem, body, i, n)
    if kind == APART_BY_INSERTED or kind == LEFT_BY_INSERTED:
        total += _compute_separation(problem, body, n, j)
    return total


@compiled
def _find_missing_contacts(problem: SceneArrays, work: NodeWorkspace) -> None:
    """Add the gain of undecided books whose completion leans on nothing, as no row excludes it."""
    n, body = problem.stored, work.body
    for k in range(n):
        upright_or_flat = body[k, POINT + 2] == 0.0 or body[k, POINT + 3] < 1e-9
        if work.role[k, STATE] >= 0 or upright_or_flat:
            continue
        reach = _compute_half_width(problem, body, k) + problem.wall_gap
        if body[k, POINT_SIDE] > 0:
            if k == 0:
                away = body[k, X] - problem.left - reach
            else:
                away = (
                    body[k, X] - body[k - 1, X] - _compute_contact_distance(problem, body, k - 1, k)
                )
        elif k == n - 1:
            away = problem.right - body[k, X] - reach
        else:
            away = body[k + 1, X] - body[k, X] - _compute_contact_distance(problem, body, k, k + 1)
        body[k, STATE_GAIN] += 0.5 * max(0.0, away) ** 2


@compiled
def select_branch(problem: SceneArrays, work: NodeWorkspace, mask: IntArray) -> int:
    """Select the branch with the largest gain.

    Returns the book to split by state, n + book to split by tilt, or -1 if nothing can be split.
    """
    n, body, role = problem.stored, work.body, work.role
    best, gain = -1, 1e-9
    for k in range(n):
        if role[k, STATE] < 0 and body[k, STATE_GAIN] > gain:
            best, gain = k, body[k, STATE_GAIN]
        wide = role[k, COLUMN] >= 0 and 2 * body[k, 6] > _NARROW
        if wide and _TILT_SHARE * body[k, TILT_GAIN] > gain:
            best, gain = n + k, _TILT_SHARE * body[k, TILT_GAIN]
    if best >= 0:
        return best
    for k in range(n):  # a book that would lean has a support to find
        if role[k, STATE] < 0 and (best < 0 or body[k, POINT + 2] * body[k, POINT + 3] > 1e-9):
            best = k
    if best >= 0:
        return best
    widest = _NARROW
    for k in range(n):
        if role[k, COLUMN] >= 0 and 2 * body[k, 6] > widest:
            best, widest = n + k, 2 * body[k, 6]
    return best
