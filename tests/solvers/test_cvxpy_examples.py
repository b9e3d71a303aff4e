"""Kinds of problems with integers that the pages of CVXPY and of GCSOPT show, in small.

Each is solved by `climbplan.CVXPY()` and by SCIP, with no change but the solver.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import cvxpy
import numpy as np
import pytest

import climbplan

cp: Any = cvxpy  # whose functions have no types
_RNG = np.random.default_rng(11)
_A, _B = _RNG.normal(size=(8, 5)), _RNG.normal(size=8)
_PLACES = _RNG.random((5, 2))
_COSTS = _RNG.random((4, 4))


def integer_least_squares() -> Any:
    x = cp.Variable(5, integer=True)
    return cp.Problem(cp.Minimize(cp.sum_squares(_A @ x - 4 * _B)))


def integer_least_norm() -> Any:
    x = cp.Variable(5, integer=True)
    return cp.Problem(cp.Minimize(cp.norm(_A @ x - 4 * _B)), [cp.abs(x) <= 6])


def integer_least_absolute() -> Any:
    x = cp.Variable(5, integer=True)
    return cp.Problem(cp.Minimize(cp.norm1(_A @ x - 4 * _B)), [cp.abs(x) <= 6])


def integer_chebyshev() -> Any:
    x = cp.Variable(5, integer=True)
    return cp.Problem(cp.Minimize(cp.norm_inf(_A @ x - 4 * _B)), [cp.abs(x) <= 6])


def huber_regression() -> Any:
    x = cp.Variable(5, integer=True)
    return cp.Problem(cp.Minimize(cp.sum(cp.huber(_A @ x - 4 * _B, 1.0))), [cp.abs(x) <= 6])


def boolean_square() -> Any:
    x = cp.Variable(boolean=True)
    return cp.Problem(cp.Minimize(cp.square(x - 0.2)))


def boolean_in_a_constraint() -> Any:
    x, t = cp.Variable(boolean=True), cp.Variable()
    return cp.Problem(cp.Minimize(t), [cp.square(x) <= t])


def boolean_matrix() -> Any:
    X = cp.Variable((2, 3), boolean=True)
    goal = np.array([[0.1, 0.9, 0.4], [0.7, 0.2, 0.6]])
    return cp.Problem(cp.Minimize(cp.sum_squares(X - goal)), [cp.sum(X, axis=1) <= 1])


def boolean_at_indices() -> Any:
    X = cp.Variable((2, 2), boolean=[(0, 1), (1, 0)])
    return cp.Problem(cp.Minimize(cp.sum_squares(X - 0.3)), [cp.sum(X) >= 1.4])


def mixed_kinds() -> Any:
    x, y, z = cp.Variable(), cp.Variable(integer=True), cp.Variable(boolean=True)
    return cp.Problem(cp.Minimize(cp.square(x - 0.3) + cp.square(y - 1.6) + z), [x + y + z >= 2.5])


def knapsack() -> Any:
    z = cp.Variable(8, boolean=True)
    return cp.Problem(cp.Maximize(np.arange(3, 11) @ z), [np.arange(2, 10) @ z <= 17])


def assignment() -> Any:
    Z = cp.Variable((4, 4), boolean=True)
    rows = [cp.sum(Z, axis=0) == 1, cp.sum(Z, axis=1) == 1]
    return cp.Problem(cp.Minimize(cp.sum(cp.multiply(_COSTS, Z))), rows)


def set_cover() -> Any:
    z = cp.Variable(6, boolean=True)
    cover = (np.add.outer(np.arange(6), np.arange(6)) % 3 == 0).astype(float)
    return cp.Problem(cp.Minimize(np.array([3.0, 2, 4, 2, 3, 3]) @ z), [cover @ z >= 1])


def lot_sizes() -> Any:
    z, x = cp.Variable(5, boolean=True), cp.Variable(5, nonneg=True)
    stock = cp.cumsum(x) - np.cumsum([3.0, 1, 4, 1, 5])
    cost = 4 * cp.sum(z) + cp.sum(stock)
    return cp.Problem(cp.Minimize(cost), [stock >= 0, x <= 14 * z])


def facility_location() -> Any:
    Z, y = cp.Variable((4, 4), boolean=True), cp.Variable(4, boolean=True)
    rows = [cp.sum(Z, axis=1) == 1, np.ones((4, 1)) @ cp.reshape(y, (1, 4), order="C") >= Z]
    return cp.Problem(cp.Minimize(cp.sum(cp.multiply(_COSTS, Z)) + 0.4 * cp.sum(y)), rows)


def best_subset() -> Any:
    x, z = cp.Variable(5), cp.Variable(5, boolean=True)
    return cp.Problem(
        cp.Minimize(cp.sum_squares(_A @ x - _B)), [cp.abs(x) <= 3 * z, cp.sum(z) <= 2]
    )


def portfolio_with_few_assets() -> Any:
    w, z = cp.Variable(5), cp.Variable(5, boolean=True)
    rows = [cp.sum(w) == 1, w >= 0.05 * z, w <= 0.6 * z, cp.sum(z) <= 3]
    return cp.Problem(cp.Maximize(np.abs(_B[:5]) @ w - 0.2 * cp.norm(_A @ w)), rows)


def portfolio_in_lots() -> Any:
    lots = cp.Variable(5, integer=True)
    rows = [cp.sum(lots) == 10, lots >= 0]
    return cp.Problem(cp.Minimize(cp.quad_form(lots, _A.T @ _A) - 3 * np.abs(_B[:5]) @ lots), rows)


def ratio_of_squares() -> Any:
    x, y = cp.Variable(2), cp.Variable(integer=True)
    return cp.Problem(cp.Minimize(cp.quad_over_lin(x, y)), [cp.sum(x) >= 3, y >= 1, y <= 4, x <= 2])


def geometric_mean() -> Any:
    y = cp.Variable(2, integer=True)
    return cp.Problem(cp.Maximize(cp.geo_mean(y)), [y >= 1, np.array([3.0, 2.0]) @ y <= 17])


def largest_entries() -> Any:
    y = cp.Variable(4, integer=True)
    return cp.Problem(cp.Minimize(cp.sum_largest(y, 2)), [cp.sum(y) >= 9, cp.abs(y) <= 5])


def largest_of_norms() -> Any:
    center, near = cp.Variable(2), cp.Variable(5, boolean=True)
    rows = [cp.norm(center - p) <= 0.35 + 2 * (1 - near[i]) for i, p in enumerate(_PLACES)]
    return cp.Problem(cp.Maximize(cp.sum(near) - 0.1 * cp.norm(center)), rows)


def circle_in_one_of_two_rooms() -> Any:
    center, radius, room = cp.Variable(2), cp.Variable(), cp.Variable(boolean=True)
    rows = [
        center[0] + radius <= 1 + 9 * room,
        center[0] - radius >= 2 * room,
        radius <= 0.7 + room,
    ]
    return cp.Problem(
        cp.Maximize(radius), [*rows, center >= radius, center[1] + radius <= 1.8, center[0] <= 3.5]
    )


def shortest_path_through_balls() -> Any:
    """Two ways between fixed ends, each through a point in a disc: perspective of the lengths."""
    z, start, goal = cp.Variable(2, boolean=True), np.zeros(2), np.array([3.0, 0.0])
    points, lengths = cp.Variable((2, 2)), cp.Variable((2, 2))
    rows = [cp.sum(z) == 1]
    for way, middle in enumerate(np.array([[1.0, 1.5], [2.0, -1.1]])):
        rows.append(cp.norm(points[way] - z[way] * middle) <= 0.5 * z[way])
        rows.append(cp.norm(points[way] - z[way] * start) <= lengths[way, 0])
        rows.append(cp.norm(points[way] - z[way] * goal) <= lengths[way, 1])
    return cp.Problem(cp.Minimize(cp.sum(lengths)), rows)


def traveling_salesman() -> Any:
    n = len(_PLACES)
    Z, order = cp.Variable((n, n), boolean=True), cp.Variable(n)
    distance = np.linalg.norm(_PLACES[:, None] - _PLACES[None], axis=2)
    rows = [cp.sum(Z, axis=0) == 1, cp.sum(Z, axis=1) == 1, cp.diag(Z) == 0, order >= 0]
    rows += [
        order[i] - order[j] + n * Z[i, j] <= n - 1
        for i in range(1, n)
        for j in range(1, n)
        if i != j
    ]
    return cp.Problem(cp.Minimize(cp.sum(cp.multiply(distance, Z))), [*rows, order <= n])


def spanning_tree() -> Any:
    n = 4
    Z, flow = cp.Variable((n, n), boolean=True), cp.Variable((n, n), nonneg=True)
    balance = cp.sum(flow, axis=0) - cp.sum(flow, axis=1)
    rows = [flow <= (n - 1) * Z, balance[1:] == 1, cp.sum(Z) == n - 1]
    return cp.Problem(cp.Minimize(cp.sum(cp.multiply(_COSTS + 9 * np.eye(n), Z))), rows)


def switched_control() -> Any:
    x, u, on = cp.Variable(6), cp.Variable(5), cp.Variable(5, boolean=True)
    rows = [x[0] == 2, x[1:] == 1.1 * x[:-1] + u, cp.abs(u) <= on, cp.sum(on) <= 3]
    return cp.Problem(cp.Minimize(cp.sum_squares(x) + 0.1 * cp.sum_squares(u)), rows)


def piecewise_cost() -> Any:
    x, z = cp.Variable(nonneg=True), cp.Variable(2, boolean=True)
    rows = [x <= 2 * z[0] + 5 * z[1], x >= 2 * z[1], cp.sum(z) == 1, x >= 1.5]
    return cp.Problem(cp.Minimize(cp.pos(x - 3) + 2 * z[0] + z[1] + 0.1 * x), rows)


def small_sudoku() -> Any:
    Z = [cp.Variable((4, 4), boolean=True) for _ in range(4)]
    rows = [sum(Z) == 1, Z[0][0, 0] == 1, Z[1][1, 2] == 1, Z[2][3, 3] == 1]
    for digit in Z:
        rows += [cp.sum(digit, axis=0) == 1, cp.sum(digit, axis=1) == 1]
        rows += [cp.sum(digit[i : i + 2, j : j + 2]) == 1 for i in (0, 2) for j in (0, 2)]
    return cp.Problem(cp.Minimize(0), rows)


def no_point() -> Any:
    y = cp.Variable(2, integer=True)
    return cp.Problem(cp.Minimize(cp.sum(y)), [2 * y[0] - 2 * y[1] == 1, cp.abs(y) <= 9])


def no_end() -> Any:
    y = cp.Variable(2, integer=True)
    return cp.Problem(cp.Maximize(cp.sum(y)), [y[0] <= 3])


EXAMPLES: tuple[Callable[[], Any], ...] = (
    integer_least_squares, integer_least_norm, integer_least_absolute, integer_chebyshev,
    huber_regression, boolean_square, boolean_in_a_constraint, boolean_matrix, boolean_at_indices,
    mixed_kinds, knapsack, assignment, set_cover, lot_sizes, facility_location, best_subset,
    portfolio_with_few_assets, portfolio_in_lots, ratio_of_squares, geometric_mean,
    largest_entries, largest_of_norms, circle_in_one_of_two_rooms, shortest_path_through_balls,
    traveling_salesman, spanning_tree, switched_control, piecewise_cost, small_sudoku, no_point,
    no_end,
)  # fmt: skip


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: str(example.__name__))
def test_as_scip(example: Callable[[], Any]) -> None:
    problem = example()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # CVXPY explains statuses
        problem.solve(solver=cp.SCIP)
        status, value = problem.status, problem.value
        problem.solve(solver=climbplan.CVXPY())
    assert problem.status == status
    if status == "optimal":
        assert problem.value == pytest.approx(value, rel=2e-4, abs=1e-5)
        assert all(row.violation().max() <= 1e-5 for row in problem.constraints)
