"""Default grids and cost cuts: valid for every feasible point, and on the factors they should."""

from __future__ import annotations

import numpy as np
import pytest
from own_problems import islands_problem

from climbplan.methods.envelope_rounds import (
    EnvelopeOptions,
    build_default_partitions,
    format_variable_name,
    restrict_to_cost,
    solve_micp,
)
from climbplan.methods.table import solve_instance
from climbplan.program import Problem, Program
from climbplan.program.box import propagate_box


def products() -> Program:
    """x0 meets every other variable, y0 y1 is a product of its own, z x1 needs no grid."""
    p = Program("products")
    x, y = p.continuous("x", (3,), -1.0, 1.0), p.continuous("y", (2,), -2.0, 3.0)
    z = p.binary("z", (1,))
    p.between("shared", np.array([x[0] * x[1], x[0] * x[2], x[0] * y[0]]), -1.0, 1.0)
    p.between("own", y[0] * y[1], -1.0, 1.0)
    p.between("switched", z[0] * x[1], -1.0, 0.5)
    p.minimise("cost", np.sum(x**2) + np.sum(y**2))
    return p


def test_one_grid_for_every_product_and_shared_factors_first() -> None:
    problem = Problem("products", products())
    instance = problem.instance({})
    grids = build_default_partitions(problem, instance, propagate_box(instance), 5)
    names = [format_variable_name(problem, int(grid.variables[0])) for grid in grids]
    assert names == ["x[0]", "y[0]"] or names == ["x[0]", "y[1]"]
    assert all(grid.count == 5 for grid in grids)


def test_the_problem_chooses_first_and_rounds_make_it_finer() -> None:
    problem = Problem("products", products(), partitions={"y": [-2.0, 0.0, 3.0], "x": 2})
    instance = problem.instance({})
    grids = build_default_partitions(problem, instance, propagate_box(instance), 5, finer=2)
    by_name = {format_variable_name(problem, int(g.variables[0])): g for g in grids}
    assert set(by_name) == {"x[0]", "x[1]", "x[2]", "y[0]", "y[1]"}
    assert by_name["x[0]"].count == 4
    np.testing.assert_allclose(by_name["y[1]"].lower[:, 0], [-2.0, -1.0, 0.0, 1.5])


@pytest.mark.parametrize("seed", range(3))
def test_cost_rows_keep_everything_cheaper(seed: int) -> None:
    problem = islands_problem()
    rng = np.random.default_rng(seed)
    theta = problem.sample_parameters(rng)
    instance = problem.instance(theta)
    incumbent = solve_instance(problem, theta, "mpcc").result
    assert incumbent.objective is not None
    cut = restrict_to_cost(instance, incumbent)
    new = slice(instance.A.shape[0], None)
    cheaper = 0
    for _ in range(3000):
        x = rng.uniform(instance.lower, instance.upper)
        x[instance.integer] = np.round(x[instance.integer])
        row = cut.A[new] @ x
        within = (row >= cut.row_lower[new] - 1e-9) & (row <= cut.row_upper[new] + 1e-9)
        if instance.objective(x) <= incumbent.objective:
            cheaper += 1
            assert within.all()
    assert cheaper > 0
    assert len(cut.row_lower) > len(instance.row_lower)
    before, after = propagate_box(instance), propagate_box(cut)
    assert (after.upper - after.lower).sum() < (before.upper - before.lower).sum()


@pytest.mark.parametrize("disjunctions", ["big-m", "hull"])
@pytest.mark.parametrize("encoding", ["unary", "log2"])
def test_rounds_tighten_the_bound(disjunctions: str, encoding: str) -> None:
    problem = islands_problem()
    theta = {"goal": np.array([1.4, -0.2])}
    instance = problem.instance(theta)
    best = solve_instance(problem, theta, "minlp-scip").result
    assert best.objective is not None
    bounds = []
    for rounds in (1, 3):
        options = EnvelopeOptions("highs", 2, rounds, disjunctions, encoding)  # type: ignore[arg-type]
        result = solve_micp(problem, instance, options, gap=1e-6)
        assert result.objective == pytest.approx(best.objective, abs=1e-4)
        assert result.bound <= best.objective + 1e-6
        bounds.append(result.bound)
    assert bounds[1] >= bounds[0] - 1e-9


def test_a_crossed_box_is_confirmed_before_it_counts_as_proof() -> None:
    p = Program("crossed")
    x = p.continuous("x", (1,), 0.0, 1.0)
    p.between("beyond", x, 2.0, 3.0)
    p.minimise("cost", x[0] ** 2)
    problem = Problem("crossed", p)
    result = solve_micp(problem, problem.instance({}))
    assert result.status == "infeasible"
    assert any("SCIP" in line for line in result.log)
