"""Linear rows that hold for every placement in a node of the branch and bound.

A node fixes the slot and the state of the inserted book and gives every stored book a set of
states and, if that is a single lean, an interval of tilts. With x the centres of the stored books
and d the differences of tilts from the middles of their intervals, the rows read

    x_j - x_i >= D_ij                            no overlap, order
    x_j - x_i >= D_i,ins + D_ins,j               room for the inserted book (its x eliminated)
    x_j >= left + e_j,  x_i <= right - e_i       walls, e half the width over the ground
    x_j >= left + e_ins + D_ins,j, ...           the inserted book between wall and book
    x_j - x_i <= U_ij                            a leaning book touches its neighbour or wall

with D, U and e replaced by planes or constants on the safe side. On intervals without width they
are the exact rows of a placement with these tilts.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.contact import pair_ceiling
from climbplan.bookshelf.exact.pairs import pair_floor
from climbplan.bookshelf.exact.problem import HEIGHT, LEAN_LEFT, LEAN_RIGHT, WIDTH, Problem
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
    NUMBER,
    ORDER,
    PATH,
    REACH_HIGH,
    REACH_LOW,
    RHS,
    RIGHT,
    RIGHT_BY_INSERTED,
    SECOND,
    SIDE,
    STATE,
    TOUCH,
    TOUCH_LEFT,
    TOUCH_RIGHT,
    Sheet,
)


@compiled
def least_floor(problem: Problem, mask: IntArray, i: int, j: int) -> float:
    """Least D of book i left of book j over the states that they may have."""
    least = np.inf
    for a in range(4):
        if mask[i] >> a & 1:
            for b in range(4):
                if mask[j] >> b & 1:
                    least = min(least, problem.floor[i, j, a, b])
    return least


@compiled
def _floor(
    problem: Problem, sheet: Sheet, mask: IntArray, i: int, j: int
) -> tuple[float, float, float, float]:
    """Constant and plane below D of book i left of book j."""
    book, seat = problem.book, sheet.seat
    if sheet.role[i, STATE] < 0 or sheet.role[j, STATE] < 0:
        least = least_floor(problem, mask, i, j)
        return least, least, 0.0, 0.0
    constant, plane, g, h = pair_floor(
        seat[i, SIDE], book[i, WIDTH], book[i, HEIGHT], seat[i],
        seat[j, SIDE], book[j, WIDTH], book[j, HEIGHT], seat[j], 0.0,
        problem.depth,
    )  # fmt: skip
    if plane < constant:
        return constant, constant, 0.0, 0.0
    return constant, plane, g, h


@compiled
def _reach_floor(problem: Problem, sheet: Sheet, k: int) -> tuple[float, float]:
    """Line below the half width of book k, which is concave in the tilt: its secant."""
    box = sheet.seat[k]
    if sheet.role[k, STATE] < 0:
        return box[REACH_LOW], 0.0
    h, w = 0.5 * problem.book[k, HEIGHT], 0.5 * problem.book[k, WIDTH]
    first, last = h * box[0] + w * box[1], h * box[4] + w * box[5]
    return 0.5 * (first + last), (0.5 * (last - first) / box[6] if box[6] > 0 else 0.0)


@compiled
def _add(
    sheet: Sheet, kind: float, i: int, j: int,
    at_i: float, at_j: float, tilt_i: float, tilt_j: float, number: float, offset: float,
) -> None:  # fmt: skip
    """Append at_i x_i + at_j x_j + tilt_i d_i + tilt_j d_j >= +-number + offset, minus for touch.

    The inserted book and the walls have no column: their coefficients are zero.
    """
    r = sheet.rows[0]
    sheet.rows[0] += 1
    sheet.pair[r, FIRST], sheet.pair[r, SECOND] = i, j
    for v in range(sheet.C.shape[1]):
        sheet.C[r, v] = 0.0
    if at_i != 0.0:
        sheet.C[r, i] = at_i
    if at_j != 0.0:
        sheet.C[r, j] = at_j
    if tilt_i != 0.0 and sheet.role[i, COLUMN] >= 0:
        sheet.C[r, sheet.role[i, COLUMN]] = tilt_i
    if tilt_j != 0.0 and sheet.role[j, COLUMN] >= 0:
        sheet.C[r, sheet.role[j, COLUMN]] = tilt_j
    sheet.side[r, KIND], sheet.side[r, NUMBER] = kind, number
    sheet.side[r, RHS] = offset - number if TOUCH <= kind < BOX else offset + number


@compiled
def _add_creases(problem: Problem, sheet: Sheet, i: int, j: int) -> None:
    """Planes on both sides of a crease of D, for two leaning books."""
    book, seat = problem.book, sheet.seat
    if sheet.role[i, COLUMN] < 0 or sheet.role[j, COLUMN] < 0:
        return
    r = sheet.rows[0] - 1
    for aim in (-1.0, 1.0):
        _, p, g, h = pair_floor(
            seat[i, SIDE], book[i, WIDTH], book[i, HEIGHT], seat[i],
            seat[j, SIDE], book[j, WIDTH], book[j, HEIGHT], seat[j], aim,
            problem.depth,
        )  # fmt: skip
        same_i = abs(g + sheet.C[r, sheet.role[i, COLUMN]]) < 1e-6
        same_j = abs(h + sheet.C[r, sheet.role[j, COLUMN]]) < 1e-6
        if p > -1e9 and not (same_i and same_j):
            _add(sheet, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)


@compiled
def write_rows(problem: Problem, sheet: Sheet, slot: int, mask: IntArray) -> None:
    """All rows of a prepared node but those that others imply."""
    n, seat = problem.stored, sheet.seat
    own = seat[n, REACH_HIGH]  # half width of the inserted book
    sheet.rows[0] = 0

    # Neighbours
    seat[0, PATH] = 0.0
    for i in range(n - 1):
        j = i + 1
        least = -np.inf
        if slot == j:
            before, p, g, _ = _floor(problem, sheet, mask, i, n)
            behind, q, _, h = _floor(problem, sheet, mask, n, j)
            least = before + behind
            _add(sheet, APART_BY_INSERTED, i, j, -1.0, 1.0, -g, -h, p + q, 0.0)
        if least < seat[i, REACH_HIGH] + seat[j, REACH_HIGH]:
            constant, p, g, h = _floor(problem, sheet, mask, i, j)
            least = max(least, constant)
            _add(sheet, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)
            _add_creases(problem, sheet, i, j)
        if least < 0:
            least = 0.0
            _add(sheet, ORDER, i, j, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
        seat[j, PATH] = seat[i, PATH] + least

    # Books farther apart
    for i in range(n):
        for j in range(i + 2, n):
            between = seat[j, PATH] - seat[i, PATH]
            far = seat[i, REACH_HIGH] + seat[j, REACH_HIGH]
            if far > between:
                _, p, g, h = _floor(problem, sheet, mask, i, j)
                _add(sheet, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)
            if i < slot <= j and far + 2 * own > between:
                _, p, g, _ = _floor(problem, sheet, mask, i, n)
                _, q, _, h = _floor(problem, sheet, mask, n, j)
                _add(sheet, APART_BY_INSERTED, i, j, -1.0, 1.0, -g, -h, p + q, 0.0)

    _write_walls(problem, sheet, slot, mask)
    _write_contacts(problem, sheet)
    for k in range(n):
        if sheet.role[k, COLUMN] >= 0:
            _add(sheet, BOX, k, k, 0.0, 0.0, 1.0, 0.0, -seat[k, 6], 0.0)
            _add(sheet, BOX, k, k, 0.0, 0.0, -1.0, 0.0, -seat[k, 6], 0.0)


@compiled
def _write_walls(problem: Problem, sheet: Sheet, slot: int, mask: IntArray) -> None:
    n, seat, left, right = problem.stored, sheet.seat, problem.left, problem.right
    own, last = seat[n, REACH_HIGH], problem.stored - 1
    _add(sheet, ALONE, n, n, 0.0, 0.0, 0.0, 0.0, 2 * own, left - right)

    # Left wall: what lies behind the first book is held off by it.
    start = seat[0, REACH_LOW]
    for j in range(n):
        far = seat[j, REACH_HIGH]
        ahead = start + seat[j, PATH] if j > 0 else 0.0  # of this book's centre at least
        if j >= slot and (j == 0 or 2 * own + far > ahead):
            constant, p, _, h = _floor(problem, sheet, mask, n, j)
            _add(sheet, LEFT_BY_INSERTED, j, j, 0.0, 1.0, 0.0, -h, p, left + own)
            ahead = max(ahead, own + constant)
        if far > ahead:
            p, h = _reach_floor(problem, sheet, j)
            _add(sheet, LEFT, j, j, 0.0, 1.0, 0.0, -h, p, left)
        if j == 0:
            start = max(start, ahead)

    # Right wall
    start = seat[last, REACH_LOW]
    for back in range(n):
        i = last - back
        far = seat[i, REACH_HIGH]
        behind = start + seat[last, PATH] - seat[i, PATH] if i < last else 0.0
        if i < slot and (i == last or 2 * own + far > behind):
            constant, p, g, _ = _floor(problem, sheet, mask, i, n)
            _add(sheet, RIGHT_BY_INSERTED, i, n, -1.0, 0.0, -g, 0.0, p, own - right)
            behind = max(behind, own + constant)
        if far > behind:
            p, g = _reach_floor(problem, sheet, i)
            _add(sheet, RIGHT, i, n, -1.0, 0.0, -g, 0.0, p, -right)
        if i == last:
            start = max(start, behind)


@compiled
def _write_contacts(problem: Problem, sheet: Sheet) -> None:
    """A leaning book touches its stored neighbour or the wall on its side, eqs. (8.9), (8.10)."""
    n, book, seat, role = problem.stored, problem.book, sheet.seat, sheet.role
    for k in range(n):
        state, box = role[k, STATE], seat[k]
        at_left = state == LEAN_LEFT and k == 0
        if at_left or (state == LEAN_RIGHT and k == n - 1):
            # The half width is concave: below its tangent.
            h, w = 0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH]
            p, g = h * box[2] + w * box[3], h * box[3] - w * box[2]
            if at_left:
                offset = -problem.left - problem.wall_gap
                _add(sheet, TOUCH_LEFT, k, k, -1.0, 0.0, g, 0.0, p, offset)
            else:
                offset = problem.right - problem.wall_gap
                _add(sheet, TOUCH_RIGHT, k, n, 1.0, 0.0, g, 0.0, p, offset)
        j = k + 1
        if j < n and (state == LEAN_RIGHT or role[j, STATE] == LEAN_LEFT):
            constant = box[REACH_HIGH] + seat[j, REACH_HIGH] + problem.book_gap
            p, g, h = constant, 0.0, 0.0
            if state >= 0 and role[j, STATE] >= 0:
                p, g, h = pair_ceiling(
                    box[SIDE], book[k, WIDTH], book[k, HEIGHT], box,
                    seat[j, SIDE], book[j, WIDTH], book[j, HEIGHT], seat[j],
                    problem.book_gap,
                )  # fmt: skip
                if p > constant:
                    p, g, h = constant, 0.0, 0.0
            _add(sheet, TOUCH, k, j, 1.0, -1.0, g, h, p, 0.0)
