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

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.contact import bound_contact_distance
from climbplan.bookshelf.exact.pairs import bound_pair_separation
from climbplan.bookshelf.exact.problem import HEIGHT, LEAN_LEFT, LEAN_RIGHT, WIDTH, SceneArrays
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
    NodeWorkspace,
)


@compiled
def select_min_separation(problem: SceneArrays, mask: IntArray, i: int, j: int) -> float:
    """Select the smallest D of book i left of book j over their possible states."""
    min_separation = np.inf
    for a in range(4):
        if mask[i] >> a & 1:
            for b in range(4):
                if mask[j] >> b & 1:
                    min_separation = min(min_separation, problem.min_separation[i, j, a, b])
    return min_separation


@compiled
def _bound_separation(
    problem: SceneArrays, work: NodeWorkspace, mask: IntArray, i: int, j: int
) -> tuple[float, float, float, float]:
    """Bound D of book i left of book j from below by a constant and a plane."""
    book, body = problem.book, work.body
    if work.role[i, STATE] < 0 or work.role[j, STATE] < 0:
        min_separation = select_min_separation(problem, mask, i, j)
        return min_separation, min_separation, 0.0, 0.0
    constant, plane, g, h = bound_pair_separation(
        body[i, SIDE], book[i, WIDTH], book[i, HEIGHT], body[i],
        body[j, SIDE], book[j, WIDTH], book[j, HEIGHT], body[j], 0.0,
        problem.depth,
    )  # fmt: skip
    if plane < constant:
        return constant, constant, 0.0, 0.0
    return constant, plane, g, h


@compiled
def _bound_half_width(problem: SceneArrays, work: NodeWorkspace, k: int) -> tuple[float, float]:
    """Bound the half width of book k from below by its secant, as it is concave in the tilt."""
    box = work.body[k]
    if work.role[k, STATE] < 0:
        return box[REACH_LOW], 0.0
    h, w = 0.5 * problem.book[k, HEIGHT], 0.5 * problem.book[k, WIDTH]
    first, last = h * box[0] + w * box[1], h * box[4] + w * box[5]
    return 0.5 * (first + last), (0.5 * (last - first) / box[6] if box[6] > 0 else 0.0)


@compiled
def _append_row(
    work: NodeWorkspace, kind: float, i: int, j: int,
    x_coefficient_i: float, x_coefficient_j: float, tilt_i: float, tilt_j: float,
    number: float, offset: float,
) -> None:  # fmt: skip
    """Append a_i x_i + a_j x_j + tilt_i d_i + tilt_j d_j >= +-number + offset, minus for touch.
    The inserted book and the walls have no column: their coefficients are zero.
    """
    r = work.rows[0]
    work.rows[0] += 1
    work.pair[r, FIRST], work.pair[r, SECOND] = i, j
    for v in range(work.C.shape[1]):
        work.C[r, v] = 0.0
    if x_coefficient_i != 0.0:
        work.C[r, i] = x_coefficient_i
    if x_coefficient_j != 0.0:
        work.C[r, j] = x_coefficient_j
    if tilt_i != 0.0 and work.role[i, COLUMN] >= 0:
        work.C[r, work.role[i, COLUMN]] = tilt_i
    if tilt_j != 0.0 and work.role[j, COLUMN] >= 0:
        work.C[r, work.role[j, COLUMN]] = tilt_j
    work.side[r, KIND], work.side[r, NUMBER] = kind, number
    work.side[r, RHS] = offset - number if TOUCH <= kind < BOX else offset + number


@compiled
def _append_crease_rows(problem: SceneArrays, work: NodeWorkspace, i: int, j: int) -> None:
    """Append the planes on both sides of a crease of D, for two leaning books."""
    book, body = problem.book, work.body
    if work.role[i, COLUMN] < 0 or work.role[j, COLUMN] < 0:
        return
    r = work.rows[0] - 1
    for aim in (-1.0, 1.0):
        _, p, g, h = bound_pair_separation(
            body[i, SIDE], book[i, WIDTH], book[i, HEIGHT], body[i],
            body[j, SIDE], book[j, WIDTH], book[j, HEIGHT], body[j], aim,
            problem.depth,
        )  # fmt: skip
        same_i = abs(g + work.C[r, work.role[i, COLUMN]]) < 1e-6
        same_j = abs(h + work.C[r, work.role[j, COLUMN]]) < 1e-6
        if p > -1e9 and not (same_i and same_j):
            _append_row(work, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)


@compiled
def write_rows(problem: SceneArrays, work: NodeWorkspace, slot: int, mask: IntArray) -> None:
    """Write all rows of a prepared node except for those that others imply."""
    n, body = problem.stored, work.body
    inserted_reach = body[n, REACH_HIGH]  # half width of the inserted book
    work.rows[0] = 0

    # Neighbours
    body[0, PATH] = 0.0
    for i in range(n - 1):
        j = i + 1
        min_separation = -np.inf
        if slot == j:
            before, p, g, _ = _bound_separation(problem, work, mask, i, n)
            behind, q, _, h = _bound_separation(problem, work, mask, n, j)
            min_separation = before + behind
            _append_row(work, APART_BY_INSERTED, i, j, -1.0, 1.0, -g, -h, p + q, 0.0)
        if min_separation < body[i, REACH_HIGH] + body[j, REACH_HIGH]:
            constant, p, g, h = _bound_separation(problem, work, mask, i, j)
            min_separation = max(min_separation, constant)
            _append_row(work, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)
            _append_crease_rows(problem, work, i, j)
        if min_separation < 0:
            min_separation = 0.0
            _append_row(work, ORDER, i, j, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
        body[j, PATH] = body[i, PATH] + min_separation

    # Books farther apart
    for i in range(n):
        for j in range(i + 2, n):
            between = body[j, PATH] - body[i, PATH]
            far = body[i, REACH_HIGH] + body[j, REACH_HIGH]
            if far > between:
                _, p, g, h = _bound_separation(problem, work, mask, i, j)
                _append_row(work, APART, i, j, -1.0, 1.0, -g, -h, p, 0.0)
            if i < slot <= j and far + 2 * inserted_reach > between:
                _, p, g, _ = _bound_separation(problem, work, mask, i, n)
                _, q, _, h = _bound_separation(problem, work, mask, n, j)
                _append_row(work, APART_BY_INSERTED, i, j, -1.0, 1.0, -g, -h, p + q, 0.0)

    _write_walls(problem, work, slot, mask)
    _write_contacts(problem, work)
    for k in range(n):
        if work.role[k, COLUMN] >= 0:
            _append_row(work, BOX, k, k, 0.0, 0.0, 1.0, 0.0, -body[k, 6], 0.0)
            _append_row(work, BOX, k, k, 0.0, 0.0, -1.0, 0.0, -body[k, 6], 0.0)


@compiled
def _write_walls(problem: SceneArrays, work: NodeWorkspace, slot: int, mask: IntArray) -> None:
    n, body, left, right = problem.stored, work.body, problem.left, problem.right
    inserted_reach, last = body[n, REACH_HIGH], problem.stored - 1
    _append_row(work, ALONE, n, n, 0.0, 0.0, 0.0, 0.0, 2 * inserted_reach, left - right)

    # Left wall: what lies behind the first book is held off by it.
    start = body[0, REACH_LOW]
    for j in range(n):
        far = body[j, REACH_HIGH]
        ahead = start + body[j, PATH] if j > 0 else 0.0  # of this book's centre at least
        if j >= slot and (j == 0 or 2 * inserted_reach + far > ahead):
            constant, p, _, h = _bound_separation(problem, work, mask, n, j)
            _append_row(work, LEFT_BY_INSERTED, j, j, 0.0, 1.0, 0.0, -h, p, left + inserted_reach)
            ahead = max(ahead, inserted_reach + constant)
        if far > ahead:
            p, h = _bound_half_width(problem, work, j)
            _append_row(work, LEFT, j, j, 0.0, 1.0, 0.0, -h, p, left)
        if j == 0:
            start = max(start, ahead)

    # Right wall
    start = body[last, REACH_LOW]
    for back in range(n):
        i = last - back
        far = body[i, REACH_HIGH]
        behind = start + body[last, PATH] - body[i, PATH] if i < last else 0.0
        if i < slot and (i == last or 2 * inserted_reach + far > behind):
            constant, p, g, _ = _bound_separation(problem, work, mask, i, n)
            _append_row(
                work, RIGHT_BY_INSERTED, i, n, -1.0, 0.0, -g, 0.0, p, inserted_reach - right
            )
            behind = max(behind, inserted_reach + constant)
        if far > behind:
            p, g = _bound_half_width(problem, work, i)
            _append_row(work, RIGHT, i, n, -1.0, 0.0, -g, 0.0, p, -right)
        if i == last:
            start = max(start, behind)


@compiled
def _write_contacts(problem: SceneArrays, work: NodeWorkspace) -> None:
    """Write the contact rows of leaning books with neighbour or wall, eqs. (8.9), (8.10)."""
    n, book, body, role = problem.stored, problem.book, work.body, work.role
    for k in range(n):
        state, box = role[k, STATE], body[k]
        at_left = state == LEAN_LEFT and k == 0
        if at_left or (state == LEAN_RIGHT and k == n - 1):
            # The half width is concave: below its tangent.
            h, w = 0.5 * book[k, HEIGHT], 0.5 * book[k, WIDTH]
            p, g = h * box[2] + w * box[3], h * box[3] - w * box[2]
            if at_left:
                offset = -problem.left - problem.wall_gap
                _append_row(work, TOUCH_LEFT, k, k, -1.0, 0.0, g, 0.0, p, offset)
            else:
                offset = problem.right - problem.wall_gap
                _append_row(work, TOUCH_RIGHT, k, n, 1.0, 0.0, g, 0.0, p, offset)
        j = k + 1
        if j < n and (state == LEAN_RIGHT or role[j, STATE] == LEAN_LEFT):
            constant = box[REACH_HIGH] + body[j, REACH_HIGH] + problem.book_gap
            p, g, h = constant, 0.0, 0.0
            if state >= 0 and role[j, STATE] >= 0:
                p, g, h = bound_contact_distance(
                    box[SIDE], book[k, WIDTH], book[k, HEIGHT], box,
                    body[j, SIDE], book[j, WIDTH], book[j, HEIGHT], body[j],
                    problem.book_gap,
                )  # fmt: skip
                if p > constant:
                    p, g, h = constant, 0.0, 0.0
            _append_row(work, TOUCH, k, j, 1.0, -1.0, g, h, p, 0.0)
