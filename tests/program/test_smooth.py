"""Smooth blocks: stated, checked by name, held by the methods that can and refused by others."""

from __future__ import annotations

from typing import cast

import casadi as ca
import numpy as np
import pytest
import tipped_box

from climbplan.errors import UsageError
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings
from climbplan.program import Problem, Program
from climbplan.program.smooth import over_knots
from climbplan.solvers.registry import solve
from climbplan.solvers.result import SolverResult

THETA = {"start": np.array([0.0, tipped_box.HALF[1], 0.0])}


def circle(binary: bool = False) -> Program:
    """The point of a circle of radius r about the origin that is nearest to (2, 1)."""
    p = Program("circle")
    r = p.parameter("r", ())
    x = p.continuous("x", (2,), -3.0, 3.0, unit="m")
    p.smooth("circle", [ca.sqrt(x[0] ** 2 + x[1] ** 2) - r[()]], unit="m")
    if binary:
        left = p.binary("left", ())
        p.when("side", left, x[0], upper=0.0)
        p.when("side", left, x[0], lower=0.0, value=False)
        p.minimise("left", -10.0 * left[()])
    p.minimise("distance", (x[0] - 2) ** 2 + (x[1] - 1) ** 2)
    return p


def test_a_smooth_block_is_checked_by_its_name() -> None:
    program = circle()
    report = program.check(np.array([3.0, 4.0]), {"r": 4.0})
    (block,) = [b for b in report.blocks if b.name == "circle"]
    assert block.residual == pytest.approx(1.0)
    assert block.unit == "m"
    assert program.instantiate({"r": 4.0}).violation(np.array([3.0, 4.0])) == pytest.approx(1.0)
    assert program.counts()["smooth_rows"] == 1
    assert program.instantiate({"r": 4.0}).features == {"smooth"}


def test_what_is_not_a_number_is_no_point() -> None:
    p = Program("logarithm")
    x = p.continuous("x", (1,), -1.0, 1.0)
    p.smooth("log", ca.log(x[0]), -10.0, 0.0)
    assert p.instantiate().violation(np.array([-0.5])) == np.inf


@pytest.mark.parametrize("r", [0.5, 1.5])
def test_nlp_follows_the_parameters(r: float) -> None:
    problem = Problem("circle", circle(), start=lambda _: {"x": [1, 0]})
    found = solve_instance(problem, {"r": r}, "nlp").result
    assert found.x is not None
    np.testing.assert_allclose(found.x, r * np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-6)


def test_a_start_without_derivatives_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    found = solve_instance(Problem("circle", circle()), {"r": 1.0}, "nlp").result  # from the origin
    assert (found.status, found.x) == ("limit", None)
    assert "IPOPT: Invalid_Number_Detected" in found.log[0]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("method", ["mpcc", "mccormick", "pinned", "admm", "minlp-bonmin"])
def test_integers_beside_smooth_rows(method: str) -> None:
    problem = Problem("circle", circle(binary=True), start=lambda _: {"left": 1.0, "x": [-1, 1]})
    found = solve_instance(
        problem, {"r": 1.0}, cast("Method", method), MethodSettings(time_limit=20.0)
    ).result
    assert found.x is not None
    assert found.objective is not None
    np.testing.assert_allclose(found.x, [0.0, 1.0, 1.0], atol=1e-5)
    assert found.bound <= found.objective


def test_infeasible_without_the_smooth_rows_is_infeasible_with_them() -> None:
    p = circle(binary=True)
    x = p.variables["x"]
    assert x.stop == 2
    extra = p.continuous("y", (1,), 0.0, 1.0)
    p.between("never", extra, 2.0, 3.0)
    found = solve_instance(Problem("circle", p), {"r": 1.0}, "mccormick").result
    assert found.status == "infeasible"


def test_methods_that_cannot_hold_them_say_so() -> None:
    problem = Problem("circle", circle(binary=True))
    with pytest.raises(UsageError, match="cannot hold smooth rows: use minlp-bonmin, mpcc"):
        solve_instance(problem, {"r": 1.0}, "minlp-scip")
    with pytest.raises(UsageError, match="holds no integers: use mpcc"):
        solve_instance(problem, {"r": 1.0}, "nlp")
    with pytest.raises(UsageError, match=r"cannot hold smooth .*mpcc"):
        solve(circle().instantiate({"r": 1.0}), "clarabel")
    with pytest.raises(UsageError, match="cannot hold smooth rows; use ipopt"):
        solve_instance(
            Problem("circle", circle(binary=True), start=lambda _: {}),
            {"r": 1.0},
            "pinned",
            MethodSettings(solver="sqp"),
        )


def test_a_function_is_mapped_over_knots() -> None:
    corners = tipped_box.corner_positions()
    symbols = np.array(ca.SX.sym("q", 6).elements(), dtype=object).reshape(2, 3)
    assert over_knots(corners, [symbols]).shape == (2, 8)
    with pytest.raises(ValueError, match="argument 0 has 2 entries a knot, expected 3"):
        over_knots(corners, [symbols[:, :2]])
    with pytest.raises(ValueError, match="takes 1 and returns 1 vectors, expected 2 and one"):
        over_knots(corners, [symbols, symbols])


def _tipped(found: SolverResult) -> None:
    assert found.x is not None
    pose = tipped_box.problem.program.value("pose", found.x)
    assert pose[-1, 2] == pytest.approx(-np.pi / 2, abs=2e-3)


def test_a_box_is_tipped_over() -> None:
    """Rotation, contact and moments in one statement: scheduled, pinned, and found."""
    given = solve_instance(tipped_box.scheduled, THETA, "nlp").result
    kept = solve_instance(tipped_box.problem, THETA, "pinned").result
    assert given.objective == pytest.approx(2.1425, rel=1e-3)
    assert kept.objective == pytest.approx(given.objective, rel=1e-3)
    _tipped(kept)


@pytest.mark.slow
def test_contacts_of_a_tipped_box_are_found_by_complementarity() -> None:
    found = solve_instance(tipped_box.problem, THETA, "mpcc").result
    _tipped(found)
    assert found.x is not None
    assert tipped_box.problem.program.check(found.x, THETA).passed(1e-6)
