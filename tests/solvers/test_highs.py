"""HiGHS and SCIP on instances with integers: agreement, limits, refusals, model files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import highspy
import numpy as np
import pyscipopt
import pytest

from climbplan.errors import UsageError
from climbplan.program import Instance, Program
from climbplan.solvers.highs.instances import save_highs_model, solve_highs
from climbplan.solvers.scip.bilinear import save_bilinear_model, solve_minlp_scip
from climbplan.solvers.tree.repair import repair_point


def knapsack(seed: int, quadratic: bool, items: int = 12, balls: bool = False) -> Instance:
    rng = np.random.default_rng(seed)
    p = Program("knapsack")
    z = p.binary("z", (items,))
    x = p.continuous("x", (2,), -3.0, 3.0)
    weight = rng.uniform(1, 5, (items, 2))
    p.between("weight", z @ weight + x, -np.inf, weight.sum(axis=0) / 2)
    if balls:
        p.ball("near", np.stack([x - 0.5 * z[:2]]), 1.0)
    p.minimise("value", -(z @ rng.uniform(1, 5, items)))
    if quadratic:
        p.minimise("spread", np.sum((x - rng.normal(size=2) * 3) ** 2) + 0.5 * (x[0] - z[0]) ** 2)
    else:
        p.minimise("shift", np.sum(x * np.array([-1.0, -0.5])))
    return p.instantiate()


@pytest.mark.parametrize(("quadratic", "balls"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("seed", range(3))
def test_highs_and_scip_agree(seed: int, quadratic: bool, balls: bool) -> None:
    instance = knapsack(seed, quadratic, balls=balls)
    one, other = solve_highs(instance, gap=1e-6), solve_minlp_scip(instance, gap=1e-5)
    assert one.status == other.status == "optimal"
    assert one.objective is not None
    assert one.objective == pytest.approx(other.objective, rel=1e-5)
    assert one.bound <= one.objective
    assert one.gap is not None
    assert one.gap <= 1e-6


def test_limits_keep_what_is_known() -> None:
    instance = knapsack(0, True, items=40)
    nothing = solve_highs(instance, time_limit=0.0)
    assert nothing.status == "limit"
    assert nothing.x is None
    short = solve_highs(instance, gap=1e-9, time_limit=0.5)
    assert short.status in ("feasible", "optimal", "limit")
    if short.x is not None:
        assert short.objective is not None
        assert short.bound <= short.objective


def test_infeasible_is_proved() -> None:
    p = Program("none")
    z = p.binary("z", (2,))
    p.between("sum", np.sum(z, keepdims=True), 0.4, 0.6)
    for solve in (solve_highs, solve_minlp_scip):
        assert solve(p.instantiate()).status == "infeasible"


def test_what_highs_cannot_hold_is_refused() -> None:
    p = Program("product")
    x = p.continuous("x", (2,), 0.0, 1.0)
    p.between("product", x[:1] * x[1:], 0.2, 0.3)
    with pytest.raises(UsageError, match="cannot hold products"):
        solve_highs(p.instantiate())
    with pytest.raises(UsageError, match="products cannot be written"):
        save_highs_model(p.instantiate(), Path("x.lp"))


@pytest.mark.parametrize("suffix", [".lp", ".mps"])
def test_model_files_are_read_back(tmp_path: Path, suffix: str) -> None:
    instance = knapsack(1, False)
    best = solve_highs(instance, gap=1e-7)
    save_highs_model(instance, tmp_path / f"h{suffix}")
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.readModel(str(tmp_path / f"h{suffix}"))
    solver.run()
    assert solver.getInfo().objective_function_value == pytest.approx(best.objective, rel=1e-4)
    save_bilinear_model(knapsack(1, True), tmp_path / f"s{suffix}")
    model = pyscipopt.Model()
    model.hideOutput()
    model.readProblem(str(tmp_path / f"s{suffix}"))
    model.optimize()
    expected = solve_highs(knapsack(1, True), gap=1e-7).objective
    assert model.getObjVal() == pytest.approx(expected, rel=1e-3)
    with pytest.raises(UsageError):
        save_highs_model(instance, tmp_path / "x.txt")
    with pytest.raises(UsageError):
        save_bilinear_model(instance, tmp_path / "missing" / "x.lp")


def test_scip_takes_a_start_and_proves_products() -> None:
    p = Program("product")
    x = p.continuous("x", (2,), -2.0, 2.0)
    p.between("hyperbola", x[:1] * x[1:], 1.0, 1.0)
    p.minimise("sum", np.sum(x))
    instance = p.instantiate()
    start = np.array([-2.0, -0.5])
    result = solve_minlp_scip(instance, gap=1e-5, start=start)
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-2.5, abs=1e-5)
    assert result.x is not None
    assert instance.violation(result.x) < 1e-7


def test_mending_projects_onto_products() -> None:
    p = Program("circle")
    x = p.continuous("x", (2,), -2.0, 2.0)
    p.equal("circle", x[:1] ** 2 + x[1:] ** 2 - 1)
    instance = p.instantiate()
    near = repair_point(instance, np.array([0.61, 0.83]))
    assert instance.violation(near) < 1e-7
    np.testing.assert_allclose(near, [0.6, 0.8], atol=0.03)
    assert instance.violation(repair_point(instance, np.zeros(2))) == pytest.approx(
        1.0
    )  # no slope there


def test_highs_says_nothing_of_itself() -> None:
    # In a process of its own: HiGHS says it once, and past Python's own output
    code = "from climbplan.solvers.highs.model import create_highs\ncreate_highs().run()\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert done.stderr == ""
