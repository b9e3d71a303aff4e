"""Lower bound on the cost of every placement in a node, and where it points.

The rows of `exact_rows` with the cost's x part, which is exact, and a quadratic near its turn part
make a least-distance program. Its multipliers give the bound: with any multipliers m >= 0 no
placement in the node costs less than

    m . b + sum_k min_x [(x - x0_k)^2 - (C^T m)_k x] + sum_k min_d [f_k(d) - (C^T m)_k d]

where d runs over the interval and f_k, the cost of lifting and turning, is bounded below there.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.problem import (
    BEST_TILT,
    COS0,
    HEIGHT,
    LEAN_LEFT,
    LEAN_RIGHT,
    LEANS_LEFT,
    STATE_COST,
    WIDTH,
    X0,
    Y0,
    Problem,
)
from climbplan.bookshelf.exact.qp import CUT_OFF, EMPTY, SOLVED, STUCK, solve_least_distance
from climbplan.bookshelf.exact.rows import write_rows
from climbplan.bookshelf.exact.sheet import (
    COLUMN,
    MIDDLE,
    PRICE,
    RHS,
    STATE,
    TARGET,
    TILT,
    WEIGHT,
    Sheet,
    X,
    prepare,
)

_PULL = 1e-3  # share of h^2 added to the weight of a tilt, so that the program is well posed
_LEAN_COST = 0.3  # [mm^2] in the choice of the cheapest state


@compiled
def cheapest_state(problem: Problem, k: int, mask: int) -> int:
    """The state among those of a mask that costs least by itself."""
    best, cost = -1, np.inf
    for state in range(4):
        if mask >> state & 1:
            here = problem.book[k, STATE_COST + state]
            # A lean costs about as much as what it is near to, but needs a support; of two leans
            # the one to the side that the book is on already comes first.
            if state == LEAN_LEFT or state == LEAN_RIGHT:
                here += _LEAN_COST
                if (state == LEAN_LEFT) == (problem.book[k, LEANS_LEFT] > 0):
                    here -= 1e-3
            if here < cost:
                best, cost = state, here
    return best


@compiled
def turn_cost(problem: Problem, k: int, s: float, c: float) -> float:
    """Cost of lifting and turning a book to the tilt with this sine and cosine."""
    book = problem.book[k]
    y = 0.5 * (book[WIDTH] * s + book[HEIGHT] * c) - book[Y0]
    c -= book[COS0]
    return y * y + c * c


@compiled
def relax(
    problem: Problem, sheet: Sheet, slot: int, mask: IntArray, span: Array, cutoff: float
) -> tuple[int, float]:
    """How the program of a node ended, and its bound.

    mask: (n + 1,) states, the inserted book's last. span: (2 n,) least and then largest tilts of
    books with a single lean.
    Of nodes that cost more than `cutoff` only that is shown. If SOLVED, columns X and TILT of the
    sheet hold the relaxed placement. With intervals of no width and single states it is an exact
    placement and the bound its cost.
    """
    n, seat, goal = problem.stored, sheet.seat, sheet.goal
    variables = prepare(problem, sheet, mask, span)
    write_rows(problem, sheet, slot, mask)
    rows = sheet.rows[0]
    constant = _write_goal(problem, sheet, mask)
    scaled = np.empty((rows, variables))
    b, z = np.empty(rows), np.empty(variables)
    price = np.empty(rows)
    for r in range(rows):
        b[r] = sheet.side[r, RHS]
        for v in range(variables):
            b[r] -= sheet.C[r, v] * goal[v, TARGET]
            scaled[r, v] = sheet.C[r, v] / math.sqrt(goal[v, WEIGHT])

    # A little past the cutoff, for the difference between the program and the Lagrangian.
    enough = 0.5 * (cutoff - constant) * (1 + 1e-6) + 1e-3
    bound = -np.inf
    while True:
        status = solve_least_distance(scaled, b, enough, price, z)
        scale = 2.0
        if status == EMPTY:  # a certificate: take a multiple of it beyond every cost
            total = 0.0
            for r in range(rows):
                total += price[r] * b[r]
            scale = 4 * problem.ceiling / total if total > 0 else 0.0
        for r in range(rows):
            sheet.side[r, PRICE] = scale * price[r]
        bound = max(bound, _lagrangian(problem, sheet, mask))
        if status == EMPTY and not bound > min(cutoff, problem.ceiling):
            status = STUCK
        if status != CUT_OFF or bound > cutoff or enough == np.inf:
            break
        enough = np.inf

    for k in range(n):
        seat[k, X] = z[k] / math.sqrt(goal[k, WEIGHT]) + goal[k, TARGET]
    for k in range(n):
        column, state = sheet.role[k, COLUMN], sheet.role[k, STATE]
        seat[k, TILT] = problem.book[k, BEST_TILT]
        if state == LEAN_LEFT or state == LEAN_RIGHT:
            seat[k, TILT] = seat[k, MIDDLE]
        if column >= 0 and status == SOLVED:
            d = z[column] / math.sqrt(goal[column, WEIGHT]) + goal[column, TARGET]
            seat[k, TILT] = min(max(seat[k, MIDDLE] + d, span[k]), span[n + k])
    return status, bound


@compiled
def _write_goal(problem: Problem, sheet: Sheet, mask: IntArray) -> float:
    """Targets and weights of the program's variables; returns the constant part of the cost."""
    n, goal = problem.stored, sheet.goal
    constant = 0.0
    for k in range(n):
        goal[k, TARGET], goal[k, WEIGHT] = problem.book[k, X0], 1.0
        column = sheet.role[k, COLUMN]
        if column < 0:
            constant += _given_turn(problem, sheet, mask, k)
        else:
            linear, square, rest = turn_model(problem, sheet.seat[k], k)
            square += _PULL * problem.book[k, HEIGHT] ** 2
            goal[column, WEIGHT] = square
            goal[column, TARGET] = -0.5 * linear / square
            constant += rest - 0.25 * linear * linear / square
    return constant


@compiled
def _given_turn(problem: Problem, sheet: Sheet, mask: IntArray, k: int) -> float:
    """Least cost of lifting and turning a book whose tilt is given or whose state is open."""
    if sheet.role[k, STATE] >= 0:
        return turn_cost(problem, k, sheet.seat[k, 2], sheet.seat[k, 3])
    least = np.inf
    for state in range(4):
        if mask[k] >> state & 1:
            least = min(least, problem.book[k, STATE_COST + state])
    return least


@compiled
def _lines(p: float, q: float, box: Array) -> tuple[float, float, float, float]:
    """Secant and tangent, value in the middle and slope each, of p sin + q cos with p, q >= 0.

    The function is concave, so that they are below and above it.
    """
    first, last = p * box[0] + q * box[1], p * box[4] + q * box[5]
    slope = 0.5 * (last - first) / box[6]
    return 0.5 * (first + last), slope, p * box[2] + q * box[3], p * box[3] - q * box[2]


@compiled
def turn_model(problem: Problem, box: Array, k: int) -> tuple[float, float, float]:
    """Linear, square and constant coefficient of a quadratic near the turn cost's lower bound."""
    book = problem.book[k]
    y, y_slope, top, top_slope = _lines(0.5 * book[WIDTH], 0.5 * book[HEIGHT], box)
    if top < book[Y0]:
        y, y_slope = top, top_slope
    c, c_slope, top, top_slope = _lines(0.0, 1.0, box)
    if top < book[COS0]:
        c, c_slope = top, top_slope
    y -= book[Y0]
    c -= book[COS0]
    return (
        2 * (y * y_slope + c * c_slope),
        y_slope * y_slope + c_slope * c_slope,
        y * y + c * c,
    )


@compiled
def least_turn(problem: Problem, box: Array, k: int, price: float) -> float:
    """Lower bound of turn cost - price d over an interval, d from its middle.

    y and cos are above their secants and below their tangents, which makes the turn cost at least
    a convex function of d; a tangent of that one near its minimum is below it everywhere.
    """
    book, r = problem.book[k], box[6]
    y, y_slope, y_top, y_top_slope = _lines(0.5 * book[WIDTH], 0.5 * book[HEIGHT], box)
    c, c_slope, c_top, c_top_slope = _lines(0.0, 1.0, box)
    y0, c0 = book[Y0], book[COS0]
    low, high = -r, r
    value = slope = at = 0.0
    for _ in range(30):
        at = 0.5 * (low + high)
        over, under = max(0.0, y + y_slope * at - y0), max(0.0, y0 - y_top - y_top_slope * at)
        over_c, under_c = max(0.0, c + c_slope * at - c0), max(0.0, c0 - c_top - c_top_slope * at)
        value = over * over + under * under + over_c * over_c + under_c * under_c
        slope = over * y_slope - under * y_top_slope + over_c * c_slope - under_c * c_top_slope
        value -= price * at
        slope = 2 * slope - price
        if slope > 0:
            high = at
        else:
            low = at
        if abs(slope) * r < 1e-7:
            break
    return value + min(slope * (-r - at), slope * (r - at))


@compiled
def _lagrangian(problem: Problem, sheet: Sheet, mask: IntArray) -> float:
    """The bound for the multipliers in column PRICE."""
    n, side = problem.stored, sheet.side
    bound = 0.0
    total = np.zeros(sheet.C.shape[1])
    for r in range(sheet.rows[0]):
        if side[r, PRICE] > 0:
            bound += side[r, PRICE] * side[r, RHS]
            for v in range(len(total)):
                total[v] += side[r, PRICE] * sheet.C[r, v]
    for k in range(n):
        bound -= total[k] * (problem.book[k, X0] + 0.25 * total[k])
        column = sheet.role[k, COLUMN]
        if column < 0:
            bound += _given_turn(problem, sheet, mask, k)
        else:
            bound += least_turn(problem, sheet.seat[k], k, total[column])
    return bound
