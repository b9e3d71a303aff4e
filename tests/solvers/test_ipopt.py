"""IPOPT and Bonmin as solvers of instances: judged by the exact check, limits kept."""

from __future__ import annotations

import time

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.solvers.bonmin import solve_bonmin
from climbplan.solvers.ipopt.instances import solve_ipopt


def hyperbola(least: float) -> Program:
    """The point of x y >= least nearest to the origin."""
    p = Program("hyperbola")
    x = p.continuous("x", (2,), 0.0, 3.0)
    p.between("product", x[:1] * x[1:], least, np.inf)
    p.minimise("norm", x[0] ** 2 + x[1] ** 2)
    return p


def switched() -> Program:
    p = Program("switched")
    x, z = p.continuous("x", (1,), -1.0, 4.0), p.binary("z", (2,))
    p.exactly_one("one", z[None, :])
    p.when("far", z[0], x, lower=3.0)
    p.when("near", z[1], x, 1.0, 1.0)
    p.minimise("cost", x[0] ** 2 - 9.5 * z[0])
    return p


def test_a_local_optimum_of_a_nonconvex_program() -> None:
    result = solve_ipopt(hyperbola(1.0).instantiate(), start=np.array([2.0, 0.1]))
    assert result.status == "feasible"
    assert result.bound == -np.inf
    np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-5)


def test_an_infeasible_program_gives_no_point() -> None:
    result = solve_ipopt(hyperbola(10.0).instantiate())
    assert result.status == "limit"
    assert result.x is None
    assert any("refused" in line for line in result.log)


def test_a_time_limit_of_zero_ends_it() -> None:
    result = solve_ipopt(hyperbola(10.0).instantiate(), time_limit=0.0)
    assert result.x is None
    assert result.nodes <= 2


def test_integers_of_the_start_are_kept() -> None:
    instance = switched().instantiate()
    with pytest.raises(UsageError, match="needs a start"):
        solve_ipopt(instance)
    near = solve_ipopt(instance, start=np.array([0.0, 0.0, 1.0]))
    far = solve_ipopt(instance, start=np.array([0.0, 1.0, 0.0]))
    assert near.objective == pytest.approx(1.0, abs=1e-6)
    assert far.objective == pytest.approx(-0.5, abs=1e-5)


def test_bonmin_finds_the_better_mode() -> None:
    result = solve_bonmin(switched().instantiate(), time_limit=20.0)
    assert result.status == "feasible"
    np.testing.assert_array_equal(np.round(result.x[1:]), [1.0, 0.0])
    assert result.objective == pytest.approx(-0.5, abs=1e-5)


def test_bonmin_without_time_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("climbplan.solvers.bonmin._GRACE", 0.01)
    begin = time.monotonic()
    result = solve_bonmin(switched().instantiate(), time_limit=0.01)
    assert time.monotonic() - begin < 60
    assert result.status == "limit"
    assert any("overran" in line for line in result.log)
