"""Convex relaxation of a node: a Lagrangian lower bound on the cost of every placement.

The rows of `rows` form a least-distance program with the exact x part of the cost and a quadratic
model of its turn part. Its multipliers give the bound by weak duality: with any multipliers m >= 0
no placement in the node costs less than

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
    SceneArrays,
)
from climbplan.bookshelf.exact.qp import CUT_OFF, EMPTY, SOLVED, STUCK, solve_least_distance
from climbplan.bookshelf.exact.rows import write_rows
from climbplan.bookshelf.exact.workspace import (
    COLUMN,
    MIDDLE,
    MULTIPLIER,
    RHS,
    STATE,
    TARGET,
    TILT,
    WEIGHT,
    NodeWorkspace,
    X,
    prepare_node,
)

_PULL = 1e-3  # share of h^2 added to the weight of a tilt, so that the program is well posed
_LEAN_COST = 0.3  # [mm^2] in the choice of the cheapest state


@compiled
def select_cheapest_state(problem: SceneArrays, k: int, mask: int) -> int:
    """Select the state of a mask that is cheapest for this book alone."""
    best, cost = -1, np.inf
    for state in range(4):
        if mask >> state & 1:
            state_cost = problem.book[k, STATE_COST + state]
            # A lean costs about as much as what it is near to, but needs a support; of two leans
            # the one to the side that the book is on already comes first.
            if state == LEAN_LEFT or state == LEAN_RIGHT:
                state_cost += _LEAN_COST
                if (state == LEAN_LEFT) == (problem.book[k, LEANS_LEFT] > 0):
                    state_cost -= 1e-3
            if state_cost < cost:
                best, cost = state, state_cost
    return best


@compiled
def evaluate_turn_cost(problem: SceneArrays, k: int, s: float, c: float) -> float:
    """Evaluate the cost of lifting and turning a book to the tilt with this sine and cosine."""
    book = problem.book[k]
    y = 0.5 * (book[WIDTH] * s + book[HEIGHT] * c) - book[Y0]
    c -= book[COS0]
    return y * y + c * c


@compiled
def solve_relaxation(
    problem: SceneArrays, work: NodeWorkspace, slot: int, mask: IntArray, span: Array, cutoff: float
) -> tuple[int, float]:
    """Solve the relaxation of a node.

    With intervals of zero width and single states the result is an exact placement and the bound
    its cost.

    Args:
        problem: the scene.
        work: workspace; if SOLVED, its columns X and TILT then have the relaxed placement.
        slot: number of stored books left of the inserted one.
        mask: (n + 1,) sets of states as bits, the inserted book's last.
        span: (2 n,) smallest, then largest tilts of books with a single lean [rad].
        cutoff: the solution stops once the bound exceeds this cost [mm^2].

    Returns:
        The status of the least-distance program, and the lower bound [mm^2].
    """
    objective = work.objective
    variables = prepare_node(problem, work, mask, span)
    write_rows(problem, work, slot, mask)
    rows = work.rows[0]
    constant = _write_objective(problem, work, mask)
    scaled = np.empty((rows, variables))
    b, z = np.empty(rows), np.empty(variables)
    multiplier = np.empty(rows)
    for r in range(rows):
        b[r] = work.side[r, RHS]
        for v in range(variables):
            b[r] -= work.C[r, v] * objective[v, TARGET]
            scaled[r, v] = work.C[r, v] / math.sqrt(objective[v, WEIGHT])

    # A little past the cutoff, for the difference between the program and the Lagrangian.
    program_cutoff = 0.5 * (cutoff - constant) * (1 + 1e-6) + 1e-3
    bound = -np.inf
    while True:
        status = solve_least_distance(scaled, b, program_cutoff, multiplier, z)
        scale = 2.0
        if status == EMPTY:  # a certificate: take a multiple of it beyond every cost
            total = 0.0
            for r in range(rows):
                total += multiplier[r] * b[r]
            scale = 4 * problem.cost_limit / total if total > 0 else 0.0
        for r in range(rows):
            work.side[r, MULTIPLIER] = scale * multiplier[r]
        bound = max(bound, _evaluate_lagrangian(problem, work, mask))
        if status == EMPTY and not bound > min(cutoff, problem.cost_limit):
            status = STUCK
        if status != CUT_OFF or bound > cutoff or program_cutoff == np.inf:
            break
        program_cutoff = np.inf

    _write_placement(problem, work, span, z, status == SOLVED)
    return status, bound


@compiled
def _write_placement(
    problem: SceneArrays, work: NodeWorkspace, span: Array, z: Array, is_solved: bool
) -> None:
    """Write the relaxed placement of a solution z (variables,) to columns X and TILT."""
    n, body, objective = problem.stored, work.body, work.objective
    for k in range(n):
        body[k, X] = z[k] / math.sqrt(objective[k, WEIGHT]) + objective[k, TARGET]
    for k in range(n):
        column, state = work.role[k, COLUMN], work.role[k, STATE]
        body[k, TILT] = problem.book[k, BEST_TILT]
        if state == LEAN_LEFT or state == LEAN_RIGHT:
            body[k, TILT] = body[k, MIDDLE]
        if column >= 0 and is_solved:
            d = z[column] / math.sqrt(objective[column, WEIGHT]) + objective[column, TARGET]
            body[k, TILT] = min(max(body[k, MIDDLE] + d, span[k]), span[n + k])


@compiled
def _write_objective(problem: SceneArrays, work: NodeWorkspace, mask: IntArray) -> float:
    """Write targets and weights of the variables; returns the constant part of the cost."""
    n, objective = problem.stored, work.objective
    constant = 0.0
    for k in range(n):
        objective[k, TARGET], objective[k, WEIGHT] = problem.book[k, X0], 1.0
        column = work.role[k, COLUMN]
        if column < 0:
            constant += _bound_undecided_turn_cost(problem, work, mask, k)
        else:
            linear, square, offset = build_turn_cost_model(problem, work.body[k], k)
            square += _PULL * problem.book[k, HEIGHT] ** 2
            objective[column, WEIGHT] = square
            objective[column, TARGET] = -0.5 * linear / square
            constant += offset - 0.25 * linear * linear / square
    return constant


@compiled
def _bound_undecided_turn_cost(
    problem: SceneArrays, work: NodeWorkspace, mask: IntArray, k: int
) -> float:
    """Bound the turn cost of a book with a fixed tilt or an undecided state."""
    if work.role[k, STATE] >= 0:
        return evaluate_turn_cost(problem, k, work.body[k, 2], work.body[k, 3])
    min_cost = np.inf
    for state in range(4):
        if mask[k] >> state & 1:
            min_cost = min(min_cost, problem.book[k, STATE_COST + state])
    return min_cost


@compiled
def _compute_secant_and_tangent(
    p: float, q: float, box: Array
) -> tuple[float, float, float, float]:
    """Compute secant and tangent of p sin + q cos with p, q >= 0: middle value and slope of each.

    The function is concave: the secant is below it and the tangent above it.
    """
    first, last = p * box[0] + q * box[1], p * box[4] + q * box[5]
    slope = 0.5 * (last - first) / box[6]
    return 0.5 * (first + last), slope, p * box[2] + q * box[3], p * box[3] - q * box[2]


@compiled
def build_turn_cost_model(problem: SceneArrays, box: Array, k: int) -> tuple[float, float, float]:
    """Build a quadratic near the turn cost's lower bound: linear, square, constant coefficient."""
    book = problem.book[k]
    y, y_slope, top, top_slope = _compute_secant_and_tangent(
        0.5 * book[WIDTH], 0.5 * book[HEIGHT], box
    )
    if top < book[Y0]:
        y, y_slope = top, top_slope
    c, c_slope, top, top_slope = _compute_secant_and_tangent(0.0, 1.0, box)
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
def bound_turn_cost(problem: SceneArrays, box: Array, k: int, multiplier: float) -> float:
    """Bound the turn cost - multiplier d over an interval from below, d from its middle.

    y and cos are above their secants and below their tangents, which makes the turn cost at least
    a convex function of d; a tangent of that one near its minimum is below it everywhere.
    """
    book, r = problem.book[k], box[6]
    y, y_slope, y_top, y_top_slope = _compute_secant_and_tangent(
        0.5 * book[WIDTH], 0.5 * book[HEIGHT], box
    )
    c, c_slope, c_top, c_top_slope = _compute_secant_and_tangent(0.0, 1.0, box)
    y0, c0 = book[Y0], book[COS0]
    low, high = -r, r
    value = slope = deviation = 0.0
    for _ in range(30):
        deviation = 0.5 * (low + high)
        over, under = (
            max(0.0, y + y_slope * deviation - y0),
            max(0.0, y0 - y_top - y_top_slope * deviation),
        )
        over_c, under_c = (
            max(0.0, c + c_slope * deviation - c0),
            max(0.0, c0 - c_top - c_top_slope * deviation),
        )
        value = over * over + under * under + over_c * over_c + under_c * under_c
        slope = over * y_slope - under * y_top_slope + over_c * c_slope - under_c * c_top_slope
        value -= multiplier * deviation
        slope = 2 * slope - multiplier
        if slope > 0:
            high = deviation
        else:
            low = deviation
        if abs(slope) * r < 1e-7:
            break
    return value + min(slope * (-r - deviation), slope * (r - deviation))


@compiled
def _evaluate_lagrangian(problem: SceneArrays, work: NodeWorkspace, mask: IntArray) -> float:
    """Evaluate the Lagrangian bound for the multipliers in column MULTIPLIER."""
    n, side = problem.stored, work.side
    bound = 0.0
    total = np.zeros(work.C.shape[1])
    for r in range(work.rows[0]):
        if side[r, MULTIPLIER] > 0:
            bound += side[r, MULTIPLIER] * side[r, RHS]
            for v in range(len(total)):
                total[v] += side[r, MULTIPLIER] * work.C[r, v]
    for k in range(n):
        bound -= total[k] * (problem.book[k, X0] + 0.25 * total[k])
        column = work.role[k, COLUMN]
        if column < 0:
            bound += _bound_undecided_turn_cost(problem, work, mask, k)
        else:
            bound += bound_turn_cost(problem, work.body[k], k, total[column])
    return bound
