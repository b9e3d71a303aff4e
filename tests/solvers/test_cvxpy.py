"""CVXPY problems by the built-in branch and bound, against SCIP, HiGHS and Clarabel."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import cvxpy as cp
import numpy as np
import pytest

import climbplan
from benchmarks.engine.conic import generate_problem
from climbplan.errors import UsageError
from climbplan.solvers.mixed_integer import outer_approximation
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.outer_approximation import ConicSearch
from climbplan.store.certificate_file import read_certificates
from climbplan.verification.certificates import verify_certificates

COUNT = 8


def random_problem(seed: int) -> Any:
    """A mixed-integer program; even seeds have a quadratic cost, odd ones second-order cones."""
    rng = np.random.default_rng(seed)
    x, z = cp.Variable(3), cp.Variable(3, boolean=True)
    y = cp.Variable(2, integer=True)
    A, B = rng.normal(size=(4, 3)), rng.normal(size=(4, 2))
    residual = A @ x + B @ y - rng.normal(size=4) * 2.0
    rows = [cp.abs(x) <= 3.0 * z, cp.abs(y) <= 4, cp.sum(z) <= 2]
    cost = cp.sum_squares(residual) if seed % 2 == 0 else cp.norm(residual)
    if seed % 2:
        rows.append(cp.norm(x - rng.normal(size=3)) <= 1.0 + 0.3 * cp.sum(y))
    return cp.Problem(cp.Minimize(cost + rng.random(3) @ z), rows)


@pytest.mark.parametrize("seed", range(COUNT))
def test_optimum_of_scip(seed: int) -> None:
    problem = random_problem(seed)
    problem.solve(solver=climbplan.CVXPY(gap=1e-5))
    status, value = problem.status, problem.value
    statistics = problem.solver_stats.extra_stats
    problem.solve(solver=cp.SCIP)
    assert status == problem.status
    if status == "optimal":
        assert value == pytest.approx(problem.value, rel=1e-3, abs=1e-4)
        assert statistics["bound"] <= problem.value * (1.0 + 1e-3) + 1e-4


def test_linear_programs_as_highs() -> None:
    rng = np.random.default_rng(3)
    z = cp.Variable(12, boolean=True)
    weight, worth = rng.random(12), rng.random(12)
    problem = cp.Problem(cp.Maximize(worth @ z), [weight @ z <= 2.0])
    assert problem.solve(solver=climbplan.CVXPY()) == pytest.approx(
        problem.solve(solver=cp.HIGHS), rel=1e-4
    )


def test_duals_of_continuous_problems() -> None:
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - 1)), [cp.norm(x) <= 1, x[0] == 0.2])
    problem.solve(solver=climbplan.CVXPY())
    value, duals = problem.value, [row.dual_value for row in problem.constraints]
    problem.solve(solver=cp.CLARABEL)
    assert value == pytest.approx(problem.value)
    assert duals == pytest.approx([row.dual_value for row in problem.constraints], rel=1e-5)


def test_integers_without_bounds_and_statuses() -> None:
    rng = np.random.default_rng(5)
    A, b = rng.random((10, 5)), rng.normal(size=10)
    x = cp.Variable(5, integer=True)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b)))
    value = problem.solve(solver=climbplan.CVXPY())
    x_box = cp.Variable(5, integer=True)
    box = cp.Problem(cp.Minimize(cp.sum_squares(A @ x_box - b)), [cp.abs(x_box) <= 50])
    assert value == pytest.approx(box.solve(solver=cp.SCIP), rel=1e-4)
    for rows, status in (
        ([x[0] >= 0.2, x[0] <= 0.8], "infeasible"),
        ([], "unbounded"),
    ):
        problem = cp.Problem(cp.Minimize(x[0]), rows)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CVXPY explains the second status
            problem.solve(solver=climbplan.CVXPY())
        assert problem.status == status


def test_the_last_tree_is_the_start_of_the_next() -> None:
    x, y, place = cp.Variable(6), cp.Variable(6, integer=True), cp.Parameter(6)
    cost = cp.sum_squares(x - place) + 0.3 * cp.sum_squares(x - y) + 0.1 * cp.sum(y)
    problem = cp.Problem(cp.Minimize(cost), [cp.abs(y) <= 6, cp.sum(y) >= 3, x <= y + 0.4])
    place.value = np.linspace(0.2, 2.7, 6)
    problem.solve(solver=climbplan.CVXPY())
    cold = problem.solver_stats.extra_stats["nodes"]
    place.value = place.value + 0.01
    problem.solve(solver=climbplan.CVXPY())
    warm, value = problem.solver_stats.extra_stats["nodes"], problem.value
    assert warm < cold
    fresh = problem.solve(solver=climbplan.CVXPY(), warm_start=False)
    assert value == pytest.approx(fresh, rel=2e-4)


def test_certificate(tmp_path: Path) -> None:
    problem = random_problem(1)
    file = tmp_path / "proof.h5"
    problem.solve(solver=climbplan.CVXPY(), certificate=file)
    proof = problem.solver_stats.extra_stats["certificate"]
    assert proof.bound >= problem.value * (1.0 - 1e-4)
    assert verify_certificates(read_certificates(file)).passed


def test_a_relaxation_without_points_has_a_certificate(tmp_path: Path) -> None:
    x, y = cp.Variable(2), cp.Variable(integer=True)
    for k, rows in enumerate(
        (
            [cp.norm(x) <= y, y >= 0, y <= 1, x[0] >= 2],
            [x[0] + y <= 1, x[0] + y >= 3, y >= 0, y <= 5],
        )
    ):
        problem, file = cp.Problem(cp.Minimize(cp.sum(x)), rows), tmp_path / f"{k}.h5"
        problem.solve(solver=climbplan.CVXPY(certificate=file))
        assert problem.status == "infeasible"
        assert verify_certificates(read_certificates(file)).passed


@pytest.mark.parametrize(
    ("rows", "status"), [((1.0, 3.0), "infeasible"), ((1.0, np.inf), "unbounded")]
)
def test_a_certificate_that_cannot_be_written_is_named(
    tmp_path: Path, rows: tuple[float, float], status: str
) -> None:
    """Multipliers of rows prove nothing over variables without bounds."""
    x, y, file = cp.Variable(), cp.Variable(integer=True), tmp_path / "proof.h5"
    sides = [x + y <= rows[0], *([x + y >= rows[1]] if np.isfinite(rows[1]) else [])]
    problem = cp.Problem(cp.Minimize(x), sides)
    with pytest.warns(UserWarning, match=f"no certificate was written to .*: the status {status}"):
        problem.solve(solver=climbplan.CVXPY(certificate=file))
    assert problem.status == status
    assert not file.exists()


def test_unsupported_cones_and_options_are_named() -> None:
    x = cp.Variable(2, integer=True)
    problem = cp.Problem(cp.Minimize(cp.sum(cp.exp(x))), [cp.abs(x) <= 2])
    with pytest.raises(cp.error.SolverError, match=r"second-order cones.*ExpCone"):
        problem.solve(solver=climbplan.CVXPY())
    with pytest.raises(cp.error.SolverError, match="no option mipgap"):
        random_problem(0).solve(solver=climbplan.CVXPY(), mipgap=0.1)


def test_programs_from_cvxpy_hold_for_every_method() -> None:
    problem = random_problem(1)
    program = climbplan.Program.from_cvxpy(problem)
    value = problem.solve(solver=climbplan.CVXPY(gap=1e-5))
    for method in ("branch-and-bound", "minlp-scip"):
        assert climbplan.solve(program, method=method).objective == pytest.approx(value, rel=1e-3)
    with pytest.raises(UsageError, match="holds no cones"):
        climbplan.solve(program, method="mpcc")


def test_programs_from_casadi() -> None:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p")
    nlp = {"x": x, "p": p, "f": ca.sumsqr(x - p), "g": ca.vertcat(x[0] + x[1], x[1] * x[2])}
    program = climbplan.Program.from_casadi(
        nlp, lbx=[-3, -3, -3], ubx=3, lbg=[-np.inf, 1.0], ubg=[1.0, 2.0], discrete=[1, 0, 0]
    )
    solution = climbplan.solve(program, {"p": [1.3]}, method="branch-and-bound")
    # By hand: x0 is an integer of at most 1 - x1, and the product of x1 and x2 is at least 1
    best = min(
        (a - 1.3) ** 2 + (b - 1.3) ** 2 + (max(1.3, 1.0 / b) - 1.3) ** 2
        for a in range(-3, 4)
        for b in np.linspace(0.34, 1.53, 2000)
        if a + b <= 1.0
    )
    assert solution.status == "optimal"
    assert solution.objective == pytest.approx(best, rel=1e-2)
    with pytest.raises(UsageError, match="lbg: 1 or 2 numbers"):
        climbplan.Program.from_casadi(nlp, lbg=[0, 0, 0])


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("gap", -1.0),
        ("gap", np.nan),
        ("gap", "small"),
        ("time_limit", None),
        ("tolerance", 0.0),
        ("absolute_gap", True),
        ("certificate", 3),
    ],
)
def test_values_of_options_are_checked(option: str, value: Any) -> None:
    with pytest.raises(cp.error.SolverError, match=f"{option}=.*expected a"):
        random_problem(0).solve(solver=climbplan.CVXPY(), **{option: value})


def test_limits_without_a_point_are_named() -> None:
    with pytest.raises(cp.error.SolverError, match="no feasible point within time_limit=0 s"):
        random_problem(0).solve(solver=climbplan.CVXPY(), time_limit=0)


@pytest.mark.parametrize("seed", range(3))
def test_absolute_values_beside_linear_costs(seed: int) -> None:
    """The epigraphs of absolute values have no bounds, and level sets of them no interior."""
    rng = np.random.default_rng(seed)
    x, y, z = cp.Variable(3), cp.Variable(2, integer=True), cp.Variable(3, boolean=True)
    cost = 0.1 * cp.sum_squares(x - 1) + rng.normal(size=2) @ y + rng.normal(size=3) @ z
    rows = [y >= -2.5, y <= 3.5, cp.abs(x) <= 5, cp.sum(y) + cp.sum(z) == 1]
    problem = cp.Problem(cp.Minimize(cost + cp.norm1(x) - 3), rows)
    value = problem.solve(solver=climbplan.CVXPY(gap=1e-6))
    status, bound = problem.status, problem.solver_stats.extra_stats["bound"]
    best = problem.solve(solver=cp.SCIP)
    assert status == "optimal"
    assert value == pytest.approx(best, abs=1e-5)
    assert bound <= best + 1e-5


def test_cones_without_an_interior() -> None:
    """With z = 0 the rows leave one point of x, which trees and convex programs meet badly."""
    rng = np.random.default_rng(9)
    x, y, z = cp.Variable(3), cp.Variable(2, integer=True), cp.Variable(2, boolean=True)
    residual = rng.normal(size=(4, 3)) @ x + rng.normal(size=(4, 2)) @ y - 3 * rng.normal(size=4)
    rows = [cp.abs(y) <= 3, cp.abs(x) <= 5, x[0] <= 4 * z[0] - 1, cp.norm(x) <= 1 + 2 * z[0]]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(residual) + 9 * z[0] + z[1]), rows)
    value = problem.solve(solver=climbplan.CVXPY(gap=1e-5))
    assert problem.status == "optimal"
    assert value == pytest.approx(problem.solve(solver=cp.SCIP), rel=1e-3)


def test_costs_flat_in_variables_without_bounds() -> None:
    place, reach = cp.Parameter(5), cp.Parameter(nonneg=True)
    x, z = cp.Variable(5), cp.Variable(5, integer=True)
    cost = cp.sum_squares(x - place) + 0.2 * cp.norm1(z) + 0.4 * cp.sum_squares(x - z)
    rows = [cp.abs(z) <= 3, cp.sum(z) >= reach, cp.norm(x) <= reach + 1]
    problem = cp.Problem(cp.Minimize(cost), rows)
    rng = np.random.default_rng(0)
    for reach_value in (0, 3, 40, 2):
        place.value, reach.value = 2 * rng.normal(size=5), reach_value
        value = problem.solve(solver=climbplan.CVXPY(gap=1e-5))
        status = problem.status
        assert value == pytest.approx(problem.solve(solver=cp.SCIP), rel=1e-3)
        assert status == problem.status


def test_problems_that_are_no_programs_are_told() -> None:
    x, z, unset = cp.Variable(2), cp.Variable(2, boolean=True), cp.Parameter(name="unset")
    for problem, words in (
        (3, "expected a cvxpy.Problem, got int"),
        (cp.Problem(cp.Minimize(3)), "no variables"),
        (cp.Problem(cp.Minimize(unset * z[0])), "parameter 'unset' has no value"),
        (cp.Problem(cp.Minimize(-cp.square(x[0]))), "DCP"),
        (cp.Problem(cp.Minimize(z[0]), [cp.sum(z) >= 9]), "infeasible: the bounds of"),
    ):
        with pytest.raises(UsageError, match=f"from_cvxpy: .*{words}"):
            climbplan.Program.from_cvxpy(problem)
    symbol, free = ca.SX.sym("x", 2), ca.SX.sym("y")
    cost = ca.sumsqr(symbol)
    for nlp, bounds, words in (
        (3, {}, "expected a dict with x and f"),
        ({"x": symbol, "f": symbol}, {}, "f: a scalar expected, got 2"),
        ({"x": symbol, "f": cost + free}, {}, "f: symbol 'y' is in neither"),
        ({"x": symbol, "f": cost}, {"lbx": np.nan}, r"x\[0\]: lbx <= ubx expected"),
        ({"x": symbol, "f": cost}, {"lbx": 3, "ubx": [4, 1]}, r"x\[1\]: lbx <= ubx expected"),
        ({"x": symbol, "f": cost}, {"lbx": "a"}, "lbx: numbers expected, got 'a'"),
    ):
        with pytest.raises(UsageError, match=f"from_casadi: {words}"):
            climbplan.Program.from_casadi(nlp, **bounds)  # type: ignore[arg-type]


@pytest.mark.merge
@pytest.mark.parametrize("conic", [False, True])
def test_twenty_programs_of_the_comparison_with_scip(conic: bool) -> None:
    """Part of `python -m benchmarks conic`, which solves 200."""
    for number in range(10):
        problem = generate_problem(np.random.default_rng([7, number, conic]), conic)
        problem.solve(solver=cp.SCIP)
        status, value = problem.status, problem.value
        problem.solve(solver=climbplan.CVXPY())
        assert problem.status == status
        assert problem.value == pytest.approx(value, rel=2e-4, abs=1e-6)
        assert problem.solver_stats.extra_stats["bound"] <= value * (1.0 + 1e-5) + 1e-6


def test_cones_by_master_programs_where_the_tree_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tree may stop after 3 programs of its nodes; the rest is up to outer approximation."""
    value = random_problem(1).solve(solver=climbplan.CVXPY())
    monkeypatch.setattr(outer_approximation, "_TREE_NODES", 3)
    for seed in (1, 3):
        problem = random_problem(seed)
        problem.solve(solver=climbplan.CVXPY())
        assert problem.status == "optimal"
        if seed == 1:
            assert problem.value == pytest.approx(value, rel=2e-4)


def test_quadratic_costs_over_cones_without_bounds() -> None:
    """A rotated cone, and integers that only the cost bounds."""
    x, y = cp.Variable(2), cp.Variable(2, integer=True)
    cost = cp.quad_over_lin(x - y - 0.3, 1.0 + cp.sum(y)) + cp.sum_squares(y - 1.7)
    problem = cp.Problem(cp.Minimize(cost), [x[0] + x[1] <= 2.0, y >= 0])
    value = problem.solve(solver=climbplan.CVXPY())
    assert problem.status == "optimal"
    best = cp.Problem(cp.Minimize(cost), [*problem.constraints, y <= 9]).solve(solver=cp.SCIP)
    assert value == pytest.approx(best, rel=1e-4)


@pytest.mark.parametrize(
    ("slope", "status"), [(2.0, "unbounded"), (0.5, "optimal"), (-2.0, "optimal")]
)
def test_cones_that_open_without_end(slope: float, status: str) -> None:
    y = cp.Variable(2, integer=True)
    problem = cp.Problem(cp.Minimize(y[1]), [cp.norm(y) <= 4.0 + slope * y[0], y[0] >= -1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # CVXPY explains the status
        problem.solve(solver=climbplan.CVXPY())
    assert problem.status == status
    if status == "optimal":
        grid = [
            (a, b)
            for a in range(-1, 60)
            for b in range(-60, 60)
            if np.hypot(a, b) <= 4.0 + slope * a + 1e-9
        ]
        assert problem.value == pytest.approx(min(b for _, b in grid), rel=1e-4)


def test_an_infeasible_program_whose_relaxation_is_unbounded() -> None:
    y = cp.Variable(2, integer=True)
    rows = [2 * y[0] - 2 * y[1] >= 0.5, 2 * y[0] - 2 * y[1] <= 1.5]
    problem = cp.Problem(cp.Minimize(y[0] + cp.norm(y[0] - y[1])), [*rows, y[1] <= 5])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver=climbplan.CVXPY(time_limit=3.0))
    assert problem.status in ("infeasible", "infeasible_or_unbounded")


def _state_vertex_of_a_ball() -> cp.Problem:
    x, y = cp.Variable(1), cp.Variable(2, integer=True)
    rows = [3 * x[0] - 2 * y[1] == 6, cp.norm1(cp.hstack([x, y])) <= 2]
    return cp.Problem(cp.Minimize(-3 * x[0] - 3 * y[0] + 2 * y[1]), rows)


def _state_corner_of_rows() -> cp.Problem:
    """A tree of active sets neither finds the corner nor excludes it."""
    x, y, z = cp.Variable(2), cp.Variable(2, integer=True), cp.Variable(boolean=True)
    v = cp.hstack([x, y, z])
    rows = np.array([[-3, -2, -2, -2, 3], [3, 1, -3, -2, -2], [-1, -1, 1, 2, 0], [3, 1, -2, 0, 3]])
    limits = [rows @ v <= np.array([-3, -3, 3, 3]), cp.norm1(v) <= 4, v >= -3]
    return cp.Problem(cp.Minimize(np.array([1, 1, -3, 3, 2]) @ v), limits)


@pytest.mark.parametrize(
    ("problem", "optimum"), [(_state_vertex_of_a_ball(), -6.0), (_state_corner_of_rows(), -12.0)]
)
def test_the_only_point_is_found_with_a_proof(
    problem: cp.Problem, optimum: float, tmp_path: Path
) -> None:
    """The level set leaves ranges of the size of tolerances."""
    problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "proof.h5"))
    assert problem.status == "optimal"
    assert problem.value == pytest.approx(optimum, abs=1e-5)
    assert verify_certificates(read_certificates(tmp_path / "proof.h5")).passed


def _state_slack_integer() -> cp.Problem:
    """An integer without cost that only relaxes the rows when it grows."""
    x, y = cp.Variable(), cp.Variable(2, integer=True)
    rows = [3 * x + y[1] == 2, -y[0] - 3 * y[1] <= 0, y[1] - y[0] <= 0, x >= -3, y >= -3]
    return cp.Problem(cp.Minimize(3 * x + 2 * y[1]), rows)


def _state_feasibility() -> cp.Problem:
    """No cost at all."""
    x, y = cp.Variable(2), cp.Variable(integer=True)
    return cp.Problem(cp.Minimize(0), [2 * x[0] + 3 * y <= 6, x[1] - y >= 0.5])


def _state_fewer_residuals_than_unknowns() -> cp.Problem:
    """Lines of minimisers for every value of the integer."""
    x, z = cp.Variable(3), cp.Variable(boolean=True)
    A = np.array([[-3.0, -2, 1], [1, -1, -3]])
    return cp.Problem(cp.Minimize(cp.sum_squares(A @ x) + (z - 0.4) ** 2))


@pytest.mark.parametrize(
    ("problem", "optimum"),
    [
        (_state_slack_integer(), -1.0),
        (_state_feasibility(), 0.0),
        (_state_fewer_residuals_than_unknowns(), 0.16),
    ],
)
def test_certificates_where_optima_reach_to_infinity(
    problem: cp.Problem, optimum: float, tmp_path: Path
) -> None:
    """The level set bounds no variable, and slopes of exactly 0 prove the optimum."""
    value = problem.solve(solver=climbplan.CVXPY(), certificate=tmp_path / "proof.h5")
    assert problem.status == "optimal"
    assert value == pytest.approx(optimum, abs=1e-6)
    proof = problem.solver_stats.extra_stats["certificate"]
    assert proof.bound == pytest.approx(optimum, abs=1e-4)
    assert verify_certificates(read_certificates(tmp_path / "proof.h5")).passed


def test_infeasible_integers_whose_bounds_follow_from_a_cone(tmp_path: Path) -> None:
    """Parity excludes every integer in a box that no row states."""
    y, x = cp.Variable(2, integer=True), cp.Variable()
    rows = [2 * y[0] - 2 * y[1] >= 0.5, 2 * y[0] - 2 * y[1] <= 1.5, cp.norm(y) <= 3 + x, x <= 9]
    problem = cp.Problem(cp.Minimize(x), rows)
    problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "proof.h5"))
    assert problem.status == "infeasible"
    assert problem.solver_stats.extra_stats["certificate"].bound == np.inf
    assert verify_certificates(read_certificates(tmp_path / "proof.h5")).passed


def test_a_certificate_that_is_weaker_than_the_search_is_named(tmp_path: Path) -> None:
    """The ball has one point in x, where its multiplier grows without end."""
    x, z = cp.Variable(), cp.Variable(2, boolean=True)
    v = cp.hstack([x, z])
    F, f = np.array([[-1.0, -2, -1], [2, 2, 3]]), np.array([3.0, -1.0])
    cost = np.array([-2.0, -1.0, -3.0]) @ v + cp.norm(F @ v + f)
    problem = cp.Problem(cp.Minimize(cost), [cp.norm(v) <= 1.0])
    with pytest.warns(UserWarning, match="the certificate proves a bound of"):
        problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "proof.h5"))
    proof = problem.solver_stats.extra_stats["certificate"]
    assert problem.value - 0.01 < proof.bound < problem.value


def test_lines_of_progress_of_a_search_and_its_proof(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = random_problem(1)
    problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "silent.h5"))
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("CLIMBPLAN_PROGRESS_SECONDS", "0.001")
    problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "proof.h5"))
    lines = capsys.readouterr().err.splitlines()
    assert {line.split()[0] for line in lines} <= {"solve", "certify"}
    assert any(line.startswith("certify") for line in lines)
    monkeypatch.setenv("CLIMBPLAN_PROGRESS_SECONDS", "soon")
    with pytest.raises(UsageError, match="positive number of seconds"):
        problem.solve(solver=climbplan.CVXPY())


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate", "ignore:CLIMBPLAN")
@pytest.mark.parametrize("is_certified", [False, True])
def test_a_second_search_replaces_no_better_point(
    is_certified: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    x = cp.Variable(2, integer=True)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - 0.3)), [x >= -2, x <= 2])
    problem.solve(solver=cp.SCIP)
    optimum = problem.value
    searches = []
    for kind, excess in ((WarmStartedTree, 0.0), (ConicSearch, 1.0)):

        def solve(
            self: Any,
            *arguments: Any,
            kind: Any = kind,
            solve: Any = kind.solve,
            excess: float = excess,
        ) -> Any:
            searches.append(kind)
            result = solve(self, *arguments)
            point, cost = result.x + excess, result.objective + excess
            return replace(result, status="feasible", x=point, objective=cost)

        monkeypatch.setattr(kind, "solve", solve)
    settings = {"certificate": tmp_path / "proof.h5"} if is_certified else {}
    problem.solve(solver=climbplan.CVXPY(**settings))
    assert searches[-1] is ConicSearch
    assert problem.solver_stats.extra_stats["status"] == "feasible"
    assert problem.value == pytest.approx(optimum, abs=1e-6)


@pytest.mark.merge
def test_certified_integers_without_bounds_and_without_a_point_need_bounds(tmp_path: Path) -> None:
    x, y = cp.Variable(integer=True), cp.Variable(integer=True)
    problem = cp.Problem(cp.Minimize(cp.square(x)), [2 * x - 2 * y == 1])
    with pytest.raises(cp.error.SolverError, match="give it bounds"):
        problem.solve(solver=climbplan.CVXPY(certificate=tmp_path / "proof.h5"))
