"""The tree that branches in space, too: against SCIP on random programs with products, limits."""

from __future__ import annotations

import numpy as np
import pytest
from random_products import random_products

from benchmarks.engine.bilinear import planar_push, turning_flyer
from climbplan.errors import UsageError
from climbplan.methods.table import solve_instance
from climbplan.methods.task import MethodSettings
from climbplan.program import Problem, Program
from climbplan.solvers.mixed_integer import spatial_method
from climbplan.solvers.mixed_integer.spatial_method import WarmStartedSpatialTree, solve_spatial
from climbplan.solvers.registry import solve

GAP = 1e-4
FLIGHT = {
    "start": np.array([1.2, 0.4, 0.0, 0.0]),
    "heading": np.array([0.0, 1.0]),
    "goal": np.array([1.5, 2.4]),
}
HARD = [110, 205, 241, 248, 298]  # of many nodes if what is wide were not split first


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """No limit of time counts what a machine compiles once."""
    solve_spatial(random_products(0).instantiate({}), GAP)


def _agrees_with_scip(seed: int) -> None:
    instance = random_products(seed).instantiate({})
    ours = solve_spatial(instance, GAP, 60.0, 1e-6)
    scip = solve(instance, "minlp-scip", 1e-5, 60.0)
    assert ours.status in ("optimal", "infeasible")
    assert (ours.status == "infeasible") == (scip.status == "infeasible")
    if ours.objective is None or scip.objective is None:
        return
    assert ours.x is not None
    assert instance.violation(ours.x, ours.assignment) <= 1e-6
    room = 1e-5 * (1.0 + abs(scip.objective))  # both may violate rows by 1e-6
    assert ours.bound <= scip.objective + room
    assert scip.bound <= ours.objective + room
    assert ours.objective <= scip.objective + room + GAP * abs(scip.objective)


@pytest.mark.parametrize("seed", [*range(12), *HARD])
def test_random_programs_with_products_agree_with_scip(seed: int) -> None:
    _agrees_with_scip(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 200))
def test_many_random_programs_with_products_agree_with_scip(seed: int) -> None:
    _agrees_with_scip(seed)


def test_random_programs_are_of_every_kind() -> None:
    instances = [random_products(seed).instantiate({}) for seed in range(40)]
    assert any(i.implications.Q.nnz for i in instances)
    assert any((i.products.first == i.products.second).any() for i in instances)
    assert any(i.integer[i.products.second].any() for i in instances)
    assert any(i.balls for i in instances)
    found = [solve_spatial(i, GAP, 60.0, 1e-6) for i in instances]
    assert any(f.status == "infeasible" for f in found)


@pytest.mark.parametrize("problem", [turning_flyer(2), planar_push(2)])
def test_user_problems_agree_with_scip(problem: Problem) -> None:
    rng = np.random.default_rng(0)
    for _ in range(2):
        theta = problem.sample_parameters(rng)
        settings = MethodSettings(gap=1e-3, time_limit=60.0)
        ours = solve_instance(problem, theta, "branch-and-bound", settings).result
        scip = solve_instance(problem, theta, "minlp-scip", settings).result
        assert ours.status == "optimal"
        assert ours.objective is not None
        assert scip.objective is not None
        assert abs(ours.objective - scip.objective) <= 1e-3 * abs(scip.objective)
        assert ours.bound <= scip.objective * (1 + 1e-6)
        assert scip.bound <= ours.objective * (1 + 1e-6)


@pytest.mark.parametrize("nodes", [1, 4, 16])
def test_a_limit_of_nodes_leaves_a_valid_bound(nodes: int) -> None:
    problem = planar_push(2)
    instance = problem.instance(problem.sample_parameters(np.random.default_rng(1)))
    best = solve_spatial(instance, 1e-4, tolerance=1e-6)
    assert best.objective is not None
    early, again = (solve_spatial(instance, 1e-4, tolerance=1e-6, nodes=nodes) for _ in range(2))
    assert early.nodes <= nodes
    assert early.bound <= best.objective
    assert (early.bound, early.objective, early.nodes) == (
        again.bound,
        again.objective,
        again.nodes,
    )


def test_a_factor_that_nothing_bounds_is_refused() -> None:
    p = Program("open")
    x = p.continuous("x", (2,))
    p.between("row", np.array([x[0] * x[1]]), 1.0, 2.0)
    p.minimise("cost", x[0] ** 2 + x[1] ** 2)
    with pytest.raises(UsageError, match="nothing bounds it"):
        solve_spatial(p.instantiate({}))


def test_no_point_is_proved_where_a_product_cannot_be_so_large() -> None:
    p = Program("empty")
    x = p.continuous("x", (2,), 0.0, 1.0)
    p.between("large", np.array([x[0] * x[1]]), 0.3, np.inf)
    p.between("small", np.array([x[0] + x[1]]), -np.inf, 1.05)
    p.minimise("cost", x[0] + x[1])
    found = solve_spatial(p.instantiate({}), GAP, 60.0)
    assert found.status == "infeasible"
    assert found.nodes > 1  # what propagation does not see


@pytest.mark.parametrize("most", [4, 40_000])
def test_remembered_boxes_cover_whatever_changes(most: int) -> None:
    """Flights whose start and goal move: bounds and proofs as from the root, nothing is lost."""
    rng, memory = np.random.default_rng(0), WarmStartedSpatialTree(GAP, 1e-6)
    memory.warm_start.max_leaves = most
    found = []
    for _ in range(6):
        start = FLIGHT["start"] + np.array([0.1, 0.1, 0.05, 0.05]) * rng.normal(size=4)
        theta = {**FLIGHT, "start": start, "goal": FLIGHT["goal"] + 0.2 * rng.normal(size=2)}
        instance = turning_flyer(2).instance(theta)
        warm, cold = memory.solve(instance, 60.0), solve_spatial(instance, GAP, 60.0, 1e-6)
        assert warm.status == cold.status
        assert warm.status in ("optimal", "infeasible")
        found.append(cold.status)
        if cold.objective is not None and warm.objective is not None:
            assert warm.objective == pytest.approx(cold.objective, rel=2 * GAP)
            assert warm.bound <= cold.objective * (1 + 1e-9)
    assert found.count("optimal") >= 3
    assert memory.leaves is not None
    assert len(memory.leaves.low) <= most


def test_the_tree_goes_on_where_branch_and_reduce_has_no_point(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its nodes of integers alone are closed without a point where local searches find none."""
    p = Program("integers and one slope")
    x, z = p.continuous("x", (1,), -3.0, 1.0)[0], p.binary("z", (2,))
    y = p.integer("y", (2,), np.array([-1, -2]), np.array([2, 0]))
    p.between("products", np.array([y[0] * y[1] + y[0] + y[1], y[0] + y[0] * z[0]]), 2.0, np.inf)
    row = 2.0 * x - 3.0 * y[0] - y[1] - 3.0 * z[0] - 3.0 * z[1] + y[1] * z[1]
    p.between("mixed", np.array([row]), -np.inf, -3.0)
    p.minimise("cost", x - 3.0 * y[0] - y[1] + 3.0 * z[0] - 2.0 * z[1])
    monkeypatch.setattr(spatial_method, "_NODES_BEFORE_REDUCTION", 0)
    monkeypatch.setattr(spatial_method, "_create_local_search", lambda _: lambda *_: np.inf)
    result = solve_spatial(p.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-11.0, abs=1e-6)
