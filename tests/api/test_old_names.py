"""Old names of the Python interface keep working and give the new ones."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import climbplan
from climbplan import errors
from climbplan.deprecation import RENAMED_CHECKS
from climbplan.limms.check.limits import LIMITS as MODULES
from climbplan.limms.check.limits import MASS_LIMITS
from climbplan.program.problem import Problem
from climbplan.program.residuals import BlockResidual, CheckReport
from climbplan.program.statement import Program
from climbplan.verification.check import GRIP_LIMITS, LIMITS, judge
from climbplan.verification.verification import Verification
from climbplan.walking.check.checker import LEG_LIMITS, LOOP_LIMITS
from climbplan.walking.check.checker import LIMITS as WALKS


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
    with pytest.warns(FutureWarning, match=r"`micp` is now `mccormick`") as warned:
        renamed = climbplan.solve(problem, method="micp")
    assert renamed.method_name == "mccormick"
    assert warned[0].filename == __file__
    with pytest.warns(FutureWarning, match=r"`Solution.why` is now `Solution.message`"):
        assert solution.why == solution.message
    with pytest.warns(FutureWarning, match=r"`Solution.method` is now `Solution.method_name`"):
        assert solution.method.startswith(solution.method_name)
    assert np.allclose(solution["x"], 0.0)


def test_a_check_is_found_by_either_name() -> None:
    verification = Verification((judge("force.penetration", 0.0), judge("goal.position", 0.0)))
    assert verification.check("goal.position").name == "goal.position"
    with pytest.warns(FutureWarning, match=r"`force.inward` is now `force.penetration`") as warned:
        assert verification.check("force.inward").name == "force.penetration"
    assert warned[0].filename == __file__
    with pytest.raises(KeyError, match=r"no check 'joint.range': expected one of force.pen"):
        verification.check("joint.range")  # the plan does not have the new one either


def test_a_block_is_found_by_either_name() -> None:
    report = CheckReport((BlockResidual("limbs.axis_collision", 0.0, "m", ()),), 0.0)
    with pytest.warns(FutureWarning, match=r"`limbs.clearance` is now `limbs.axis_collision`"):
        assert report["limbs.clearance"].unit == "m"
    mine = CheckReport((BlockResidual("objective", 0.0, "", ()),), 0.0)
    assert mine["objective"].name == "objective"  # a block of the user's own keeps its name


def test_no_check_has_an_old_name() -> None:
    tables = (LIMITS, GRIP_LIMITS, MODULES, MASS_LIMITS, WALKS, LEG_LIMITS, LOOP_LIMITS)
    names = {name for table in tables for name in table}
    assert not names & set(RENAMED_CHECKS)
    elsewhere = {"file.objective", "solution.bound", "solution.gap", "solution.consistency"}
    elsewhere |= {"spec.differences"}
    assert set(RENAMED_CHECKS.values()) <= names | elsewhere
