"""Rows with products that are cones: the same points as the rows, the same optima as SCIP's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from climbplan.methods.table import solve_instance
from climbplan.methods.task import MethodSettings
from climbplan.program import Problem, Program
from climbplan.solvers.highs.linear import (
    LinearAnswer,
    LinearProgram,
    compute_dual_bound,
    solve_linear,
)
from climbplan.solvers.mixed_integer import cone_rows
from climbplan.solvers.mixed_integer.cone_rows import state_cones

Row = Callable[[Program, Any], None]
GAP = 1e-4


def state_hyperbola(p: Program, x: Any) -> None:
    p.between("area", np.array([x[0] * x[1]]), 2.0, np.inf)


def state_shifted_hyperbola(p: Program, x: Any) -> None:
    """(x0 + x2) (x1 - 0.5) >= 1, in which x2 is no factor of its own."""
    p.between("area", np.array([x[0] * x[1] + x[2] * x[1] - 0.5 * x[0] - 0.5 * x[2]]), 1.0, np.inf)


def state_parabola(p: Program, x: Any) -> None:
    p.between(
        "square", np.array([x[0] * x[0] + x[0] * x[1] + x[1] * x[1] - 3.0 * x[2]]), -np.inf, 0.0
    )


def state_queue(p: Program, x: Any) -> None:
    """The row is a cone for x2 <= x0 alone."""
    p.between("order", np.array([x[2] - x[0]]), -np.inf, 0.0)
    p.between("queue", np.array([x[2] * x[0] + x[2] * x[1] - x[0] * x[1]]), -np.inf, 0.0)


def build(row: Row, lower: float = 0.0, upper: float = 4.0) -> Program:
    p = Program("rows")
    row(p, p.continuous("x", (3,), lower, upper))
    p.minimise("cost", 0.0)
    return p


@pytest.mark.parametrize(
    "row", [state_hyperbola, state_shifted_hyperbola, state_parabola, state_queue]
)
def test_cones_hold_where_rows_hold(row: Row) -> None:
    instance = build(row, 0.5).instantiate()
    stated = state_cones(instance)
    assert not stated.products.count
    assert "cones" in stated.features
    for x in np.random.default_rng(0).uniform(0.5, 4.0, (2000, 3)):
        by_row, by_cone = instance.violation(x), stated.violation(x)
        assert (by_row <= 1e-9) == (by_cone <= 1e-9)
        assert by_row <= 4.0 * by_cone + 1e-9  # so that a tolerance means the same


@pytest.mark.parametrize("lower", [-1.0, -4.0])
def test_rows_that_are_no_cones_stay(lower: float) -> None:
    """Factors of both signs allow both branches of a hyperbola."""
    instance = build(state_hyperbola, lower).instantiate()
    assert state_cones(instance) is instance


def test_a_solver_that_errs_makes_no_cone_of_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    instance = build(state_queue).instantiate()
    assert state_cones(instance).balls
    for wrong in (
        LinearAnswer(np.zeros(3), 1e9, np.zeros(1)),  # a value that its multipliers do not prove
        LinearAnswer(None, np.inf),  # "infeasible"
    ):
        monkeypatch.setattr(cone_rows, "solve_linear", lambda program, wrong=wrong: wrong)
        assert state_cones(instance) is instance


def test_any_multipliers_prove_a_bound_and_the_solvers_the_optimum() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        A, upper = sparse.csr_matrix(rng.normal(size=(4, 6))), rng.uniform(0.5, 2.0, 4)
        box = -rng.uniform(1.0, 2.0, 6), rng.uniform(1.0, 2.0, 6)
        program = LinearProgram(rng.normal(size=6), *box, A, -upper, upper)
        answer = solve_linear(program)
        assert answer.row_dual is not None
        bound = compute_dual_bound(program, answer.row_dual)
        assert bound == pytest.approx(answer.objective, abs=1e-6)
        for multipliers in rng.normal(size=(5, 4)):
            assert compute_dual_bound(program, multipliers) <= answer.objective + 1e-9


def test_sides_that_are_not_convex_stay() -> None:
    p = Program("below")
    x = p.continuous("x", (2,), 0.0, 4.0)
    p.between("below", np.array([x[0] * x[1]]), -np.inf, 2.0)
    p.between("both", np.array([x[0] * x[1]]), 1.0, 2.0)
    p.minimise("cost", 0.0)
    instance = p.instantiate()
    assert state_cones(instance) is instance


def build_queues(seed: int) -> Problem:
    """Choose a server for each of some demands; waiting times have no bounds."""
    rng = np.random.default_rng(seed)
    p = Program(f"queues{seed}")
    num_servers, num_demands = 2, 3
    served = p.binary("served", (num_demands, num_servers))
    opened = p.binary("opened", (num_servers,))
    wait, load = (
        p.continuous("wait", (num_servers,), 0.0),
        p.continuous("load", (num_servers,), 0.0),
    )
    weight = rng.uniform(0.1, 0.3, num_demands)
    p.exactly_one("one", served)
    p.equal("load is", load - weight @ served)
    p.between("open", load - opened, -np.inf, 0.0)
    p.between("queue", load * opened + load * wait - opened * wait, -np.inf, 0.0)
    distance = rng.uniform(0.0, 2.0, (num_demands, num_servers))
    p.minimise("cost", np.sum(distance * served) + np.sum(wait) + 0.3 * np.sum(opened))
    return Problem(p.name, p)


@pytest.mark.parametrize("seed", range(4))
def test_factors_without_bounds_agree_with_scip(seed: int) -> None:
    problem = build_queues(seed)
    settings = MethodSettings(gap=GAP, time_limit=60.0)
    ours = solve_instance(problem, {}, "auto", settings).result
    scip = solve_instance(problem, {}, "minlp-scip", settings).result
    assert ours.status == scip.status == "optimal"
    assert ours.objective is not None
    assert scip.objective is not None
    assert ours.objective == pytest.approx(scip.objective, rel=1e-4)
    assert ours.bound <= scip.objective * (1.0 + 1e-5)


def build_mixed(seed: int) -> Problem:
    """A hyperboloid, a product that is no cone, and a switch."""
    rng = np.random.default_rng([seed, 3])
    p = Program(f"mixed{seed}")
    x, z = p.continuous("x", (3,), 0.2, 4.0), p.binary("z", (2,))
    p.between("cone", np.array([x[0] * x[1] - 0.5 * x[2] * x[2]]), 1.0, np.inf)
    p.between("product", np.array([x[1] * x[2] - x[0]]), -0.5, 0.8)
    p.between("switch", np.array([z[0] + z[1] + 0.2 * x[0]]), 1.0, 2.0)
    p.minimise("cost", np.sum((x - rng.uniform(0.0, 4.0, 3)) ** 2) + rng.uniform(-1, 1, 2) @ z)
    return Problem(p.name, p)


@pytest.mark.parametrize("seed", range(6))
def test_cones_beside_products_agree_with_scip(seed: int) -> None:
    problem = build_mixed(seed)
    stated = state_cones(problem.instance({}))
    assert stated.features >= {"cones", "products"}
    settings = MethodSettings(gap=GAP, time_limit=60.0)
    ours = solve_instance(problem, {}, "branch-and-bound", settings).result
    scip = solve_instance(problem, {}, "minlp-scip", settings).result
    assert ours.status == scip.status == "optimal"
    assert ours.objective is not None
    assert scip.objective is not None
    assert ours.objective == pytest.approx(scip.objective, rel=1e-4, abs=1e-5)
    assert ours.bound <= scip.objective + 1e-5 * (1.0 + abs(scip.objective))


@pytest.mark.parametrize("curvature", [1.0, 1e-6, 1e-13])
def test_small_coefficients_of_large_variables_count(curvature: float) -> None:
    """a^2 <= b^2 + c d^2 allows a = 1 at b = 0 whatever the unit of d."""
    p = Program("units")
    a, b = p.continuous("a", (1,), 0.0, 10.0)[0], p.integer("b", (1,), 0, 3)[0]
    d = p.continuous("d", (1,), 0.0, 1.0 / np.sqrt(curvature))[0]
    p.between("row", np.array([a * a - b * b - curvature * d * d]), -np.inf, 0.0)
    p.minimise("cost", b - a)
    settings = MethodSettings(gap=GAP, time_limit=60.0)
    result = solve_instance(Problem("units", p), {}, "branch-and-bound", settings).result
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-1.0, abs=2 * GAP)
    assert result.bound <= -1.0


def test_rank_deficient_squares_of_any_unit_are_cones() -> None:
    rng = np.random.default_rng(0)
    for size in (1e-6, 1.0, 1e6):
        p = Program("squares")
        x = p.continuous("x", (5,), -size, size)
        t = p.continuous("t", (1,), 0.0, 100.0)
        vectors = rng.normal(size=(2, 5)) / size @ x
        p.between("row", np.array([np.sum(vectors * vectors) - t[0]]), -np.inf, 0.0)
        p.minimise("cost", t[0])
        stated = state_cones(p.instantiate())
        assert not stated.products.count
        assert [balls.f.shape for balls in stated.balls] == [(1, 3)]
