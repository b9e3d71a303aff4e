"""Certificates of the tree over integers: what they prove, and that nothing false is believed."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certified_programs import GAP, certified_program, proved
from random_programs import random_program

import climbplan
import climbplan.certificates
from climbplan.certificates.checker import check
from climbplan.errors import UsageError
from climbplan.instances.cart_pole import build_walled_cart_pole
from climbplan.program import Polytope, Program
from climbplan.solvers.mixed_integer import certification, method
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.search import resolve_leaf


def _holds(seed: int) -> None:
    instance, found, certificate = certified_program(seed)
    verdict = check(instance, certificate)
    assert not verdict.faults
    if found.status == "infeasible":
        assert verdict.bound == np.inf
        assert verdict.margin > 0
        return
    assert found.objective is not None
    scale = 1.0 + abs(found.objective)
    assert verdict.bound <= found.objective + 1e-5 * scale  # answers may violate rows by 1e-6
    assert verdict.bound >= found.bound - GAP * scale


@pytest.mark.parametrize("seed", [*range(12), 27, 199, 1754, 1832, 1911, 2074])
def test_random_programs_are_proved(seed: int) -> None:
    _holds(seed)


@pytest.mark.parametrize("seed", [674, 876, 1087, 1400])
def test_what_scip_calls_infeasible_is_proved_so(seed: int) -> None:
    """Points of leaves that were refused as violated once hid that these are empty."""
    assert certified_program(seed)[1].status == "infeasible"
    _holds(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 400))
def test_many_random_programs_are_proved(seed: int) -> None:
    _holds(seed)


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_published_cart_pole(scale: float) -> None:
    problem = build_walled_cart_pole()
    instance = problem.instance({"start": scale * np.array([0.02, -0.1, 0.2, 0.3])})
    found, certificate = proved(instance, 1e-3)
    assert found.objective is not None
    bound = check(instance, certificate).bound
    assert found.objective * (1.0 - 1.001e-3) <= bound <= found.objective * (1.0 + 1e-6)


def test_two_solves_in_a_row_are_proved_each() -> None:
    """A tree that begins with the leaves of the last one."""
    problem = build_walled_cart_pole()
    tree = WarmStartedTree(1e-3, 1e-6, proves=True)
    for angle in (-0.1, -0.09):
        instance = problem.instance({"start": np.array([0.02, angle, 0.2, 0.3])})
        found = tree.solve(instance, 60.0)
        assert tree.certificate is not None
        assert found.objective is not None
        assert check(instance, tree.certificate).bound >= found.objective * (1.0 - 1.001e-3)


def test_a_search_that_stops_early_proves_what_it_has() -> None:
    problem = build_walled_cart_pole()
    instance = problem.instance({"start": np.array([0.1, 0.05, 0.1, -0.3])})
    tree = WarmStartedTree(1e-6, 1e-6, proves=True)
    found = tree.solve(instance, 60.0, nodes=4)
    assert tree.certificate is not None
    bound = check(instance, tree.certificate).bound
    best = WarmStartedTree(1e-6, 1e-6).solve(instance, 60.0).objective
    assert best is not None
    assert found.status in ("feasible", "limit")
    assert -np.inf < bound <= best * (1.0 + 1e-6)


def test_a_certificate_that_may_take_no_time_tells_what_leaves_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = build_walled_cart_pole()
    instance = problem.instance({"start": np.array([0.1, 0.05, 0.1, -0.3])})
    again: list[int] = []

    def counted(numbers: Any, search: Any, tree: Any, leaf: int) -> None:
        again.append(leaf)
        resolve_leaf(numbers, search, tree, leaf)

    monkeypatch.setattr(certification, "resolve_leaf", counted)
    tree = WarmStartedTree(1e-6, 1e-6, proves=True)
    found = tree.solve(instance, 60.0, nodes=8)
    assert tree.certificate is not None
    assert found.status in ("feasible", "limit")
    assert check(instance, tree.certificate).bound == pytest.approx(found.bound, rel=1e-5)
    assert again
    again.clear()
    whole = method.certify_search
    monkeypatch.setattr(method, "certify_search", lambda *given: whole(*given[:-1], 0.0))
    late = WarmStartedTree(1e-6, 1e-6, proves=True)
    late.solve(instance, 60.0, nodes=8)
    assert late.certificate is not None
    assert not again
    best = WarmStartedTree(1e-6, 1e-6).solve(instance, 60.0).objective
    assert best is not None
    assert -np.inf < check(instance, late.certificate).bound <= best * (1.0 + 1e-6)


def test_the_margin_of_infeasibility_is_how_far_rows_must_be_let_out() -> None:
    program = Program("apart")
    x = program.continuous("x", (1,), -10.0, 10.0)
    z = program.binary("z", (1,))
    program.between("left", np.array([x[0] + z[0]]), -np.inf, 1.0)
    program.between("right", np.array([x[0]]), 1.5, np.inf)
    program.when("one", z[0], np.array([x[0]]), -np.inf, 0.0)
    program.between("two", np.array([x[0] + x[0]]), 4.0, np.inf)
    program.minimise("cost", x[0] * x[0])
    instance = program.instantiate({})
    found, certificate = proved(instance)
    verdict = check(instance, certificate)
    assert found.status == "infeasible"
    assert verdict.bound == np.inf
    assert verdict.margin <= 0.5 + 1e-9


def test_the_checker_is_short_enough_to_be_read() -> None:
    room = Path(climbplan.certificates.__file__).parent
    lines = sum(len(path.read_text().splitlines()) for path in room.glob("*.py"))
    assert lines <= 520


def test_smooth_rows_are_refused() -> None:
    program = Program("smooth")
    x = program.continuous("x", (1,), -1.0, 1.0)
    program.smooth("row", x[0] ** 3, 0.1, 0.2)
    program.minimise("cost", x[0] * x[0])
    with pytest.raises(UsageError, match="smooth"):
        check(program.instantiate({}), certified_program(0)[2])


def test_arrays_that_do_not_fit_are_named() -> None:
    instance = random_program(0).instantiate({})
    _, certificate = proved(instance)
    verdict = check(instance, replace(certificate, point=certificate.point[:, 1:]))
    assert verdict.bound == -np.inf
    assert "point" in verdict.faults[0]
    verdict = check(instance, replace(certificate, at=np.full_like(certificate.at, np.nan)))
    assert "at" in verdict.faults[0]


def test_a_cost_that_is_not_convex_proves_nothing() -> None:
    """P is looked at: an indefinite one gives no bound by a tangent."""
    instance = random_program(2).instantiate({})
    _, certificate = proved(instance)
    P = instance.P.tolil()
    P[0, 0] = -1e4
    bent = replace(instance, P=P.tocsc())
    lowest = -0.5 * 1e4 * 25.0  # at the bound of x, far below what the multipliers say
    assert check(bent, certificate).bound < lowest / 2


def test_a_single_alternative_holds() -> None:
    program = Program("single")
    x = program.continuous("x", (2,), -5.0, 5.0)
    z = program.binary("z", (1,))
    far = Polytope.halfspaces("far", np.array([[-1.0, 0.0]]), np.array([-2.0]))
    program.one_of("place", np.array([x]), [[far]])
    program.between("row", np.array([x[1] - z[0]]), 0.2, np.inf)
    program.minimise("cost", x[0] * x[0] + x[1] * x[1])
    instance = program.instantiate({})
    found, certificate = proved(instance)
    assert found.objective == pytest.approx(4.04, abs=1e-4)
    assert check(instance, certificate).bound == pytest.approx(4.04, abs=1e-3)


def test_postures_of_a_climb_are_proved() -> None:
    """Free variables that only balls and rows bound, and no integer but choices."""
    problem, theta = climbplan.problem_from_spec("specs/climb_region.yaml")
    found = climbplan.solve(problem, theta, method="branch-and-bound", certificate=True)
    assert found.status == "optimal"
    assert found.certificate is not None
    assert found.objective is not None
    verdict = check(problem.instance(theta), found.certificate)
    assert found.objective * (1.0 - 1.01e-4) <= verdict.bound <= found.objective * (1.0 + 1e-6)


@pytest.mark.slow
def test_limits_are_kept_where_many_balls_make_nodes_slow() -> None:
    """A proof may take as long again as the search; 351 balls once made pieces of 10 s."""
    problem, theta = climbplan.problem_from_spec("specs/climb_steps.yaml")
    instance = problem.instance(theta)
    WarmStartedTree(1e-4, 1e-6).solve(instance, 1.0)  # compiles where it has to
    tree = WarmStartedTree(1e-4, 1e-6, proves=True)
    begin = time.perf_counter()
    found = tree.solve(instance, 4.0)
    assert time.perf_counter() - begin < 10.0
    assert tree.certificate is not None
    assert check(instance, tree.certificate).bound == pytest.approx(found.bound, rel=1e-4)
