"""Where to branch: which decision the bound of a node has most to gain from.

A node's relaxed solution is completed: undecided books take the state that costs least by
themselves, tilts stay where they are. Rows that the completion breaks, or whose exact form would
cost more by the row's multiplier, tell which decisions the relaxation avoids. Nothing here bears on
the validity of bounds.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.contact import pair_ceiling
from climbplan.bookshelf.exact.pairs import box_row, pair_floor
from climbplan.bookshelf.exact.problem import (
    BEST_TILT,
    FLAT,
    HEIGHT,
    STATE_COST,
    UPRIGHT,
    WIDTH,
    Problem,
    side_of,
)
from climbplan.bookshelf.exact.relaxation import cheapest_state, least_turn, turn_cost
from climbplan.bookshelf.exact.sheet import (
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
    NUMBER,
    ORDER,
    POINT,
    POINT_SIDE,
    PRICE,
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
    Sheet,
    X,
)

_TILT_SHARE = 2.0  # halving makes two nodes of one, splitting by state up to four
_NARROW = 1e-7  # [rad] intervals are not halved below this


@compiled
def find_gains(problem: Problem, sheet: Sheet, mask: IntArray) -> None:
    """Fill the gains for the node that was last relaxed.

    What a row promises goes to its undecided books if there are any, and otherwise to its leaning
    books in proportion to the squares of their intervals.
    """
    n, seat, role = problem.stored, sheet.seat, sheet.role
    for k in range(n + 1):
        seat[k, STATE_GAIN] = seat[k, TILT_GAIN] = 0.0
        _complete(problem, sheet, mask, k)
        if role[k, COLUMN] >= 0:
            # What the Lagrangian falls short of by the book's turn cost.
            price = 0.0
            for r in range(sheet.rows[0]):
                price += sheet.side[r, PRICE] * sheet.C[r, role[k, COLUMN]]
            exact = turn_cost(problem, k, seat[k, POINT + 2], seat[k, POINT + 3])
            exact -= price * (seat[k, TILT] - seat[k, MIDDLE])
            seat[k, TILT_GAIN] = max(0.0, exact - least_turn(problem, seat[k], k, price))
    for r in range(sheet.rows[0]):
        kind, i, j = sheet.side[r, KIND], sheet.pair[r, FIRST], sheet.pair[r, SECOND]
        if kind == BOX or kind == ALONE or kind == ORDER:
            continue
        slack, value = -sheet.side[r, RHS], sheet.side[r, NUMBER]
        sign = 1.0 if kind >= TOUCH else -1.0
        for k in range(n):
            slack += sheet.C[r, k] * seat[k, X]
            if role[k, COLUMN] >= 0:
                term = sheet.C[r, role[k, COLUMN]] * (seat[k, TILT] - seat[k, MIDDLE])
                slack += term
                value += sign * term
        more = max(0.0, sign * (value - _exact_number(problem, seat, kind, i, j)))
        short = max(0.0, more - max(0.0, slack))
        _share(problem, sheet, i, j, sheet.side[r, PRICE] * more + 0.5 * short * short)
    _find_missing_contacts(problem, sheet)


@compiled
def _complete(problem: Problem, sheet: Sheet, mask: IntArray, k: int) -> None:
    """Side and tilt of a book in the completion."""
    n, seat, book = problem.stored, sheet.seat, problem.book
    seat[k, POINT_SIDE] = seat[k, SIDE]
    if sheet.role[k, STATE] >= 0:
        tilt = seat[k, TILT] if sheet.role[k, COLUMN] >= 0 else seat[k, MIDDLE]
        box_row(tilt, tilt, seat[k, POINT : POINT + 7])
        return
    state = cheapest_state(problem, k, mask[k])
    seat[k, POINT_SIDE] = side_of(state)
    tilt = book[k, BEST_TILT]
    if state == FLAT:
        tilt = math.pi / 2
    elif state == UPRIGHT:
        tilt = 0.0
    box_row(tilt, tilt, seat[k, POINT : POINT + 7])
    if k < n:
        least = np.inf
        for other in range(4):
            if mask[k] >> other & 1:
                least = min(least, book[k, STATE_COST + other])
        cost = turn_cost(problem, k, seat[k, POINT + 2], seat[k, POINT + 3])
        seat[k, STATE_GAIN] = max(0.0, cost - least)


@compiled
def _share(problem: Problem, sheet: Sheet, i: int, j: int, gain: float) -> None:
    n, seat, role = problem.stored, sheet.seat, sheet.role
    undecided, total = 0, 0.0
    for k in range(n):
        if k == i or k == j:
            if role[k, STATE] < 0:
                undecided += 1
            elif role[k, COLUMN] >= 0:
                total += seat[k, 6] ** 2
    for k in range(n):
        if k == i or k == j:
            if undecided > 0:
                if role[k, STATE] < 0:
                    seat[k, STATE_GAIN] += gain / undecided
            elif role[k, COLUMN] >= 0:
                seat[k, TILT_GAIN] += gain * seat[k, 6] ** 2 / total


@compiled
def _apart(problem: Problem, seat: Array, i: int, j: int) -> float:
    """D of the completion."""
    book = problem.book
    return pair_floor(
        seat[i, POINT_SIDE], book[i, WIDTH], book[i, HEIGHT], seat[i, POINT : POINT + 7],
        seat[j, POINT_SIDE], book[j, WIDTH], book[j, HEIGHT], seat[j, POINT : POINT + 7],
        0.0, problem.depth,
    )[0]  # fmt: skip


@compiled
def _touching(problem: Problem, seat: Array, i: int, j: int) -> float:
    """U of the completion."""
    book = problem.book
    return pair_ceiling(
        seat[i, POINT_SIDE], book[i, WIDTH], book[i, HEIGHT], seat[i, POINT : POINT + 7],
        seat[j, POINT_SIDE], book[j, WIDTH], book[j, HEIGHT], seat[j, POINT : POINT + 7],
        problem.book_gap,
    )[0]  # fmt: skip


@compiled
def _half_width(problem: Problem, seat: Array, k: int) -> float:
    """e of the completion."""
    book = problem.book[k]
    return 0.5 * (book[HEIGHT] * seat[k, POINT + 2] + book[WIDTH] * seat[k, POINT + 3])


@compiled
def _exact_number(problem: Problem, seat: Array, kind: float, i: int, j: int) -> float:
    """D, U or e of a row for the completion."""
    n = problem.stored
    if kind == APART:
        return _apart(problem, seat, i, j)
    if kind == TOUCH:
        return _touching(problem, seat, i, j)
    if kind == LEFT or kind == RIGHT or kind > TOUCH:
        return _half_width(problem, seat, min(i, j))
    total = 0.0
    if kind == APART_BY_INSERTED or kind == RIGHT_BY_INSERTED:
        total += _apart(problem, seat, i, n)
    if kind == APART_BY_INSERTED or kind == LEFT_BY_INSERTED:
        total += _apart(problem, seat, n, j)
    return total


@compiled
def _find_missing_contacts(problem: Problem, sheet: Sheet) -> None:
    """Undecided books that would lean on nothing: no row says so yet."""
    n, seat = problem.stored, sheet.seat
    for k in range(n):
        upright_or_flat = seat[k, POINT + 2] == 0.0 or seat[k, POINT + 3] < 1e-9
        if sheet.role[k, STATE] >= 0 or upright_or_flat:
            continue
        reach = _half_width(problem, seat, k) + problem.wall_gap
        if seat[k, POINT_SIDE] > 0:
            if k == 0:
                away = seat[k, X] - problem.left - reach
            else:
                away = seat[k, X] - seat[k - 1, X] - _touching(problem, seat, k - 1, k)
        elif k == n - 1:
            away = problem.right - seat[k, X] - reach
        else:
            away = seat[k + 1, X] - seat[k, X] - _touching(problem, seat, k, k + 1)
        seat[k, STATE_GAIN] += 0.5 * max(0.0, away) ** 2


@compiled
def choose(problem: Problem, sheet: Sheet, mask: IntArray) -> int:
    """Book to split by state, n + book to split by tilt, -1 if nothing is left to split."""
    n, seat, role = problem.stored, sheet.seat, sheet.role
    best, gain = -1, 1e-9
    for k in range(n):
        if role[k, STATE] < 0 and seat[k, STATE_GAIN] > gain:
            best, gain = k, seat[k, STATE_GAIN]
        wide = role[k, COLUMN] >= 0 and 2 * seat[k, 6] > _NARROW
        if wide and _TILT_SHARE * seat[k, TILT_GAIN] > gain:
            best, gain = n + k, _TILT_SHARE * seat[k, TILT_GAIN]
    if best >= 0:
        return best
    for k in range(n):  # a book that would lean has a support to find
        if role[k, STATE] < 0 and (best < 0 or seat[k, POINT + 2] * seat[k, POINT + 3] > 1e-9):
            best = k
    if best >= 0:
        return best
    widest = _NARROW
    for k in range(n):
        if role[k, COLUMN] >= 0 and 2 * seat[k, 6] > widest:
            best, widest = n + k, 2 * seat[k, 6]
    return best
