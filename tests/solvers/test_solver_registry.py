"""Solvers by name: what is there, what is missing, what they cannot hold; model files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pyscipopt
import pytest
from random_scenes import stepping_scene

from climbplan.errors import MissingSolver, UsageError
from climbplan.program import Program
from climbplan.solvers import registry
from climbplan.solvers.model_file import save_model
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound


def test_unknown_solver_lists_the_known() -> None:
    with pytest.raises(UsageError, match="branch-and-bound"):
        registry.require("cplex")


def test_missing_solver_lists_the_available(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        registry, "find_spec", lambda name: None if name == "gurobipy" else object()
    )
    assert "gurobi" not in registry.list_available()
    with pytest.raises(MissingSolver, match=r"climbplan\[gurobi\].*available: branch-and-bound"):
        registry.solve(stepping_scene(0).instantiate(), "gurobi")


def test_required_solvers_are_available_with_versions() -> None:
    for name in ("branch-and-bound", "scip"):
        backend = registry.require(name)
        assert backend.available
        assert backend.version


def test_what_a_solver_cannot_hold_is_refused() -> None:
    p = Program("binary")
    z = p.binary("z", (2,))
    p.minimise("cost", (z[0] - 0.7) ** 2 + z[1])
    with pytest.raises(UsageError, match="integers"):
        registry.solve(p.instantiate(), "scip")


def test_looking_up_solvers_imports_none() -> None:
    code = (
        "import sys; from climbplan.solvers import registry; registry.list_available(); "
        "assert not {'daqp', 'pyscipopt', 'gurobipy', 'highspy'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("suffix", [".lp", ".mps", ".cip"])
def test_model_files_hold_the_same_problem(suffix: str, tmp_path: Path) -> None:
    instance = stepping_scene(3, rounds=2, limbs=1, patches=2).instantiate()
    path = tmp_path / f"model{suffix}"
    save_model(instance, path)
    model = pyscipopt.Model()
    model.hideOutput()
    model.readProblem(str(path))
    model.optimize()
    ours = solve_branch_and_bound(instance).objective
    assert model.getStatus() == "optimal"
    assert model.getObjVal() == pytest.approx(ours, rel=1e-3)


def test_unknown_suffix_and_missing_directory_are_usage_errors(tmp_path: Path) -> None:
    instance = stepping_scene(3, rounds=1, limbs=1).instantiate()
    with pytest.raises(UsageError, match=r"unknown suffix '.txt', expected one of .lp"):
        save_model(instance, tmp_path / "model.txt")
    with pytest.raises(UsageError, match="not a directory"):
        save_model(instance, tmp_path / "nowhere" / "model.lp")
    assert not list(tmp_path.iterdir())
