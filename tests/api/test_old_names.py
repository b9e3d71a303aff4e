"""Old names of the Python interface keep working and give the new ones."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import climbplan
from climbplan import errors
from climbplan.program.problem import Problem
from climbplan.program.statement import Program


@pytest.mark.parametrize(
    ("old", "new"), [("load", "load_spec"), ("read", "load_plan"), ("stated", "problem_from_spec")]
)
def test_old_functions_warn_and_are_the_new_ones(old: str, new: str) -> None:
    with pytest.warns(FutureWarning, match=f"`climbplan.{old}` is now `climbplan.{new}`"):
        assert getattr(climbplan, old) is getattr(climbplan, new)


@pytest.mark.parametrize(
    ("old", "new"), [("NotProved", "Unresolved"), ("PlanFails", "VerificationFailed")]
)
def test_old_errors_warn_and_are_the_new_ones(old: str, new: str) -> None:
    with pytest.warns(FutureWarning, match=f"{old}` is now `climbplan.errors.{new}`"):
        assert getattr(errors, old) is getattr(errors, new)
    with pytest.raises(AttributeError, match="no attribute 'Typo'"):
        importlib.import_module("climbplan.errors").Typo  # noqa: B018


def test_the_old_name_of_a_staged_program_warns() -> None:
    package = importlib.import_module("climbplan.program")
    with pytest.warns(FutureWarning, match="Trajectory` is now `climbplan.program.StagedProgram`"):
        assert package.Trajectory is package.StagedProgram


def test_an_old_parameter_warns_and_has_its_meaning(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    text = "kind: climb\nrobot: silvia\nterrain: {friction: 1.0, walls: {gap: 1.23, "
    text += "along: [-1, 1], up: [-1, 2]}}\n"
    text += "task: {rounds: 2, start: {com: [0, 0, 0]}, goal: {com: [0, 0, 0.2]}}\n"
    with pytest.warns(FutureWarning, match="`set` is now `overrides`"):
        loaded = climbplan.load_spec(text, set={"task.rounds": 3})  # type: ignore[call-arg]
    assert loaded.spec.task.rounds == 3  # type: ignore[union-attr]
    with pytest.raises(TypeError, match="`set` is the old name of `overrides`"):
        climbplan.load_spec(text, set={}, overrides={})  # type: ignore[call-arg]


def test_old_methods_warn_and_return_what_the_new_ones_do() -> None:
    program = Program("line")
    x = program.continuous("x", (1,), 0.0, 1.0)
    program.minimise("length", x.sum())
    with pytest.warns(FutureWarning, match=r"`Program.at` is now `Program.instantiate`"):
        assert program.at().size == 1
    problem = Problem("line", program)
    solution = climbplan.solve(problem)
    with pytest.warns(FutureWarning, match=r"`Solution.why` is now `Solution.message`"):
        assert solution.why == solution.message
    with pytest.warns(FutureWarning, match=r"`Solution.method` is now `Solution.method_name`"):
        assert solution.method.startswith(solution.method_name)
    assert np.allclose(solution["x"], 0.0)
