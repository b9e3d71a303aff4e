"""Model files of stated programs: read back by SCIP, they have the same optimum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pyscipopt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.methods.table import solve_instance
from climbplan.program import Instance, Polytope, Program
from climbplan.program.problem import Problem
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.model_file import save_model
from climbplan.solvers.scip.bilinear import solve_minlp_scip
from climbplan.solvers.separable_cost import NotConvexCost, factor_cost, is_convex


def switched(bilinear: bool, choice: bool = False) -> Instance:
    """Without its implications the optimum would be 0, with them it is not."""
    p = Program("switched")
    x, z = p.continuous("x", (2,), -2.0, 2.0), p.binary("z", (2,))
    p.exactly_one("one", z)
    p.when("first", z[0], x[0], lower=1.0)
    p.when("second", z[1], x[1], lower=1.5)
    if bilinear:
        p.between("product", x[0] * x[1], 0.5, 1.0)
    if choice:
        low = Polytope.halfspaces("low", np.array([[1.0]]), np.array([-0.5]))
        high = Polytope.halfspaces("high", np.array([[-1.0]]), np.array([-0.7]))
        p.one_of("side", x[1:], [[low, high]])
    p.minimise("cost", np.sum(x**2) + 0.1 * x[0])
    return p.instantiate()


def optimum(path: Path) -> float:
    model: Any = pyscipopt.Model()
    model.hideOutput()
    model.readProblem(str(path))
    model.optimize()
    assert model.getStatus() == "optimal"
    return float(model.getObjVal())


@pytest.mark.parametrize("suffix", [".lp", ".mps", ".cip", ".nl"])
@pytest.mark.parametrize(("bilinear", "choice"), [(False, False), (True, False), (True, True)])
def test_read_back(tmp_path: Path, suffix: str, bilinear: bool, choice: bool) -> None:
    instance = switched(bilinear, choice)
    exact = solve_minlp_scip(instance, gap=1e-7)
    assert exact.objective is not None
    assert exact.objective > 0.5
    path = tmp_path / f"model{suffix}"
    save_model(instance, path)
    assert optimum(path) == pytest.approx(exact.objective, abs=1e-4)


def saddle(integers: bool) -> Program:
    """Minimise x y + 0.1 x over a box, least at (-1, 2), with an integer offset on request."""
    p = Program("saddle")
    x = p.continuous("x", (2,), -1.0, 2.0)
    z = p.binary("z", (1,))[0] if integers else 0.0
    p.between("row", x[0] + x[1] + z, -1.0, 3.0)
    p.minimise("cost", x[0] * x[1] + 0.1 * x[0] + z)
    return p


@pytest.mark.parametrize("suffix", [".lp", ".mps", ".cip", ".nl"])
@pytest.mark.parametrize("integers", [False, True])
def test_negative_curvature_is_written(tmp_path: Path, suffix: str, integers: bool) -> None:
    path = tmp_path / f"model{suffix}"
    save_model(saddle(integers).instantiate(), path)
    assert optimum(path) == pytest.approx(-2.1, abs=1e-4)


def test_negative_curvature_is_solved_or_refused() -> None:
    """SCIP holds it, and so does `auto`; backends that need a convex cost say so."""
    instance = saddle(integers=True).instantiate()
    for solve in (solve_highs, solve_mixed_integer, factor_cost):
        with pytest.raises(NotConvexCost, match="not convex"):
            solve(instance)
    problem = Problem("saddle", saddle(integers=True))
    exact = solve_instance(problem, {}).result
    assert exact.status == "optimal"
    assert exact.objective == pytest.approx(-2.1, abs=1e-4)
    assert exact.bound <= exact.objective
    for method in ("branch-and-bound", "mccormick", "pinned"):
        with pytest.raises(NotConvexCost, match="minlp-scip"):
            solve_instance(problem, {}, method)


@given(hnp.arrays(float, (3, 2), elements=st.floats(-2.0, 2.0)), st.floats(0.0, 1.0))
def test_convexity_is_recognised(rows: Any, deficit: float) -> None:
    """F'F is convex whatever its rank; less a multiple of the identity it is not."""
    H = rows.T @ rows
    assert is_convex(sparse.csc_matrix(H))
    shift = float(np.linalg.eigvalsh(H)[0]) + 1e-3 * (1.0 + deficit)
    assert not is_convex(sparse.csc_matrix(H - shift * np.eye(2)))


def test_a_plain_form_needs_no_extension_of_the_format(tmp_path: Path) -> None:
    """Big-M rows: any mixed-integer quadratic solver reads the file."""
    save_model(switched(bilinear=False), tmp_path / "model.lp")
    assert "->" not in (tmp_path / "model.lp").read_text()


def test_casadi_reads_the_nl_file(tmp_path: Path) -> None:
    save_model(switched(bilinear=True), tmp_path / "model.nl")
    builder = ca.NlpBuilder()
    builder.import_nl(str(tmp_path / "model.nl"))
    assert len(builder.x) >= 4
    assert (tmp_path / "model.col").read_text().split()[0].startswith("x")


def test_what_cannot_be_written(tmp_path: Path) -> None:
    p = Program("open")
    x, z = p.continuous("x", (1,)), p.binary("z", (1,))
    p.when("up", z, x, lower=1.0)
    p.minimise("cost", x[0] ** 2)
    with pytest.raises(UsageError, match="not bounded"):
        save_model(p.instantiate(), tmp_path / "model.nl")
    with pytest.raises(UsageError, match="unknown suffix"):
        save_model(p.instantiate(), tmp_path / "model.txt")


def test_balls_in_mps_files_add_no_variables_and_no_entry_twice(tmp_path: Path) -> None:
    p = Program("stones")
    x = p.continuous("x", (2,), -3.0, 3.0)
    p.ball("reach", (x - np.array([0.5, 0.0]))[None, :], 1.2)
    square = np.vstack([np.eye(2), -np.eye(2)])
    stones = [
        Polytope.halfspaces(f"stone{c}", square, np.array([c + 0.3, 0.3, 0.3 - c, 0.3]))
        for c in (0.0, 1.8)
    ]
    p.one_of("stones", x[None, :], [stones])
    p.minimise("cost", np.sum((x - np.array([1.3, 0.4])) ** 2) + x[0] * x[1])
    instance, path = p.instantiate(), tmp_path / "model.mps"
    save_model(instance, path)
    model: Any = pyscipopt.Model()
    model.hideOutput()
    model.readProblem(str(path))
    stated = {v.name for v in model.getVars() if v.name[0] in "xi"}
    assert stated == {"x0", "x1", "in0_0", "in0_1"}
    sections = path.read_text().split("QCMATRIX")[1:]
    for section in sections:
        entries = [tuple(line.split()[:2]) for line in section.splitlines()[1:] if line[0] == " "]
        assert len(entries) == len(set(entries))
    best = solve_minlp_scip(instance, gap=1e-7).objective
    assert optimum(path) == pytest.approx(best, abs=1e-4)
