"""Searches tell the meter of a run what they have found: incumbents and bounds of the problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from climbplan.program.instance import Instance
from climbplan.program.polytope import Polytope
from climbplan.program.statement import Program
from climbplan.progress import ProgressMeter, hide_searches, is_observed
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.mixed_integer.outer_approximation import solve_conic
from climbplan.solvers.result import SolverResult
from climbplan.solvers.scip.bilinear import solve_minlp_scip
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound


def assign_costs(seed: int = 3, size: int = 14) -> Instance:
    """A knapsack with a quadratic cost, which takes every solver some nodes."""
    rng = np.random.default_rng(seed)
    p = Program("knapsack")
    take = p.binary("take", (size,))
    weight = rng.uniform(1.0, 3.0, size)
    p.between("weight", weight @ take, 0.5 * weight.sum(), np.inf)
    p.minimise("cost", np.sum((take - rng.uniform(0.2, 0.6, size)) ** 2))
    return p.instantiate()


def pass_a_post(steps: int = 7) -> Instance:
    """A path of short steps past a square, left or right of it."""
    p = Program("past a post")
    x = p.continuous("place", (steps + 1, 2), -2.0, 2.0)
    p.equal("start", x[0] - np.array([-0.1, -1.2]))
    p.equal("goal", x[-1] - np.array([0.1, 1.2]))
    normals = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    sides = [Polytope.halfspaces(str(n), np.array([n]), np.array([-0.4])) for n in normals]
    p.one_of("side", x, [sides] * (steps + 1))
    p.minimise("length", np.sum((x[1:] - x[:-1]) ** 2))
    return p.instantiate()


@pytest.mark.parametrize(
    ("solve", "build"),
    [
        (solve_mixed_integer, assign_costs),
        (solve_minlp_scip, assign_costs),
        (solve_conic, assign_costs),
        (solve_branch_and_bound, pass_a_post),
    ],
    ids=["compiled tree", "scip", "outer approximation", "tree of choices"],
)
def test_the_last_report_is_the_answer(
    solve: Callable[[Instance], SolverResult], build: Callable[[], Instance]
) -> None:
    with ProgressMeter().observe() as meter:
        result = solve(build())
    assert result.status == "optimal"
    assert meter.search.incumbent == pytest.approx(result.objective, rel=1e-3)
    assert meter.search.bound is not None
    assert meter.search.bound <= result.objective + 1e-6
    assert "incumbent" in meter.describe()


def test_subproblems_are_not_told() -> None:
    with ProgressMeter().observe() as meter, hide_searches():
        assert not is_observed()
        solve_mixed_integer(assign_costs())
    assert meter.search.incumbent is None
