"""Every exact method has the same optimum of the public instances, and no bound above it."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

import climbplan
from climbplan.instances.families import FAMILIES, NamedInstance, list_instances
from climbplan.program import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.mixed_integer.cost import Unbounded
from climbplan.solvers.registry import BACKENDS, solve
from climbplan.solvers.result import SolverResult

GAP = 1e-4
LIMIT = 60.0  # [s]
SLACK = 2e-3  # relative: gap, and rows within tolerances of other solvers


def answers(instance: Instance) -> dict[str, SolverResult]:
    """What each exact method says; branch-and-bound needs bounds where nothing costs."""
    found = {"minlp-scip": solve(instance, "minlp-scip", GAP, LIMIT)}
    with contextlib.suppress(Unbounded):
        found["branch-and-bound"] = solve(instance, "branch-and-bound", GAP, LIMIT)
    if instance.features <= BACKENDS["scip"].accepts:
        found["scip"] = solve(instance, "scip", GAP, LIMIT)
    if "products" not in instance.features:
        found["highs"] = solve(BigM().apply(instance).instance, "highs", GAP, LIMIT)
    return found


def check_agreement(instance: Instance) -> None:
    """Compare statuses, optima and bounds."""
    found = answers(instance)
    best = min((r.objective for r in found.values() if r.objective is not None), default=np.inf)
    slack = SLACK * max(abs(best), 1e-3) if np.isfinite(best) else 0.0
    for name, result in found.items():
        assert not (result.status == "infeasible" and np.isfinite(best)), name
        assert np.isinf(best) or result.bound <= best + slack, (name, result.bound, best)
        if result.status == "optimal":
            assert result.objective == pytest.approx(best, abs=slack), name


@pytest.mark.parametrize("family", [family.name for family in FAMILIES])
@pytest.mark.slow
def test_easy_instances(family: str) -> None:
    for named in list_instances():
        if (named.family.name, named.level) == (family, "easy"):
            check_agreement(named.generate(0))


@pytest.mark.merge
def test_postures_that_scip_cut_off_by_indicators() -> None:
    """SCIP called 0.00312 optimal, where 0.002138 is feasible."""
    postures = next(family for family in FAMILIES if family.name == "postures")
    instance = NamedInstance(postures, "medium", 0).generate(0)
    for solver in ("scip", "minlp-scip"):
        result = solve(instance, solver, GAP, LIMIT)
        assert result.objective == pytest.approx(0.0021384, rel=1e-3)


@pytest.mark.merge
def test_steps_whose_optimum_is_on_propagated_bounds() -> None:
    """SCIP called these postures infeasible: bounds of the box differ from rows by 1e-9."""
    problem, theta = climbplan.problem_from_spec(
        "specs/climb_steps.yaml", {"task.rounds": 4, "task.goal": {"com": [0.0, 0.0, 0.4]}}
    )
    instance = problem.instance(theta)
    result = solve(instance, "scip", GAP, LIMIT)
    assert result.objective == pytest.approx(0.0034158, rel=1e-3)
