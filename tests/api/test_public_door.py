"""`import climbplan`: load, plan, solve, verify, read, and plans of one shape for every kind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tipped_box

import climbplan
from climbplan.api.plan import Plan
from climbplan.errors import PlanFileError, SpecError, Unresolved, UsageError, VerificationFailed

SPECS = Path(__file__).parents[2] / "specs"
WALLS = {"friction": 1.0, "walls": {"gap": 1.23, "along": [-1.0, 1.0], "up": [-1.0, 2.0]}}
CLIMB = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": WALLS,
    "task": {"rounds": 2, "start": {"com": [0, 0, 0]}, "goal": {"com": (0, 0, 0.2)}},
}


@pytest.fixture(scope="module")
def climb() -> Plan:
    return climbplan.plan(CLIMB)


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import climbplan, sys; print(sorted({m.split('.')[0] for m in sys.modules}))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(listed(told.stdout)) & {"numpy", "casadi", "pydantic", "h5py", "scipy"}


def test_a_plan_gives_its_executive(climb: Plan, tmp_path: Path) -> None:
    executive = climb.executive()
    assert executive.motor_command.shape == (6, 3)
    assert not executive.finished


def listed(text: str) -> list[str]:
    return [name.strip(" '[]\n") for name in text.split(",")]


def test_every_name_is_there_with_a_docstring() -> None:
    assert len(climbplan.__all__) <= 20
    for name in climbplan.__all__:
        assert getattr(climbplan, name).__doc__, name
        assert name in dir(climbplan)
    with pytest.raises(AttributeError, match="it has CVXPY, BookshelfSpec"):
        climbplan.plam  # noqa: B018


def test_a_spec_from_file_text_mapping_and_model() -> None:
    file = climbplan.load_spec(SPECS / "climb_steps.yaml", overrides={"task.rounds": 3})
    text = climbplan.load_spec((SPECS / "climb_steps.yaml").read_text(), {"task.rounds": 3})
    assert file.spec == text.spec
    assert file.spec.task.rounds == 3
    mapping = climbplan.load_spec(CLIMB)
    model = climbplan.load_spec(climbplan.ClimbSpec.model_validate(CLIMB))
    assert mapping.spec == model.spec
    changed = climbplan.load_spec(
        CLIMB, {"task.goal.com": np.array([0.0, 0.0, 0.1]), "study": None}
    )
    assert changed.spec.task.goal.com == (0.0, 0.0, 0.1)


def test_mistakes_are_the_command_lines() -> None:
    with pytest.raises(SpecError, match="did you mean 'goal'"):
        climbplan.load_spec(CLIMB, overrides={"task.gaol.com": [0, 0, 1]})
    with pytest.raises(SpecError, match="no such file"):
        climbplan.load_spec("climb_stepz.yaml")
    with pytest.raises(UsageError, match="got int"):
        climbplan.load_spec(3)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="dotted keys"):
        climbplan.load_spec(CLIMB, overrides={"task..goal": 1})
    with pytest.raises(UsageError, match="plans are made of specs of kind climb"):
        climbplan.plan(SPECS / "dataset_mpc.yaml")
    with pytest.raises(Unresolved) as refused:
        climbplan.plan(CLIMB, overrides={"task.goal.com": [0, 0, 0.5]}, method="micp")
    assert refused.value.conflicts


def test_arrays_under_the_names_of_the_file(climb: Plan) -> None:
    assert climb.kind == "climb"
    assert climb.rounds.com.shape == (3, 3)
    assert climb["instants/force"].shape[1:] == (6, 3)
    assert climb.robot.limb_names[0] == "RF"
    assert climb.robot.mass == pytest.approx(10.3)
    assert climb.status == "optimal"
    assert climb.verified
    assert climb.solvers["method"] == "micp"
    assert climb.units("rounds/com") == ("m", "world")
    assert {"rounds", "instants", "objective"} <= set(dir(climb))
    with pytest.raises(ValueError, match="read-only"):
        climb.rounds.com[0, 0] = 1.0
    with pytest.raises(AttributeError, match="it has com, "):
        climb.rounds.como  # noqa: B018
    with pytest.raises(KeyError):
        climb["rounds/como"]
    with pytest.raises(UsageError, match="no array"):
        climb.units("rounds/como")


def test_a_plan_is_saved_read_checked_drawn_and_exported(climb: Plan, tmp_path: Path) -> None:
    path = climb.save(tmp_path / "out")
    assert path == tmp_path / "out" / "plan.h5"
    with pytest.raises(UsageError, match="force=True"):
        climb.save(path)
    again = climbplan.load_plan(tmp_path / "out")
    assert again.summary == climb.summary
    assert any(line.startswith("posture") for line in again.summary)
    assert again.warnings == climb.warnings
    np.testing.assert_array_equal(again.instants.force, climb.instants.force)
    assert climbplan.verify(again).passed
    assert climbplan.verify(path).badge == "verified"
    assert "climb" in repr(again)
    page = again.write_report(tmp_path / "report")
    assert page.read_text().startswith("<!DOCTYPE html>")
    assert (tmp_path / "report" / "report.json").exists()
    text = again.to_csv(tmp_path / "motion.csv")
    assert (tmp_path / "motion.csv").read_text() == text
    frame = pytest.importorskip("pandas") and again.to_frame()
    assert len(frame) == len(again.trajectory.time)


def test_against_another_spec(climb: Plan) -> None:
    assert climb.verify(CLIMB).passed
    further = climb.verify(CLIMB, overrides={"task.goal.com": [0, 0, 0.3]})
    assert not further.passed
    with pytest.raises(UsageError, match="kind `transition`"):
        climb.verify(SPECS / "transition_flat.yaml")
    with pytest.raises(UsageError, match="none is given"):
        climb.verify(overrides={"task.rounds": 3})


def test_a_simulated_climb(climb: Plan, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    found = climb.simulate(tmp_path, friction=1.2)
    assert found.passed == (found.fall_time is None and not found.slips)
    assert (tmp_path / "simulation.csv").exists()
    assert "torque" in repr(found)
    with pytest.raises(UsageError, match="no condition frictoin"):
        climb.simulate(frictoin=0.5)


def test_a_plan_that_fails_its_verification_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a method leaves something out that the checks look at."""
    from climbplan.climb.plan.climb_plan import ClimbPlan
    from climbplan.climb.planner import planner

    made = planner.plan_by_method

    def lighter(*arguments: Any) -> ClimbPlan:
        plan = made(*arguments)
        plan.instants.mu[:] = 0.01
        return plan

    monkeypatch.setattr(planner, "plan_by_method", lighter)
    with pytest.raises(VerificationFailed) as failed:
        climbplan.plan(CLIMB, method="micp")
    assert isinstance(failed.value.plan, Plan)
    assert not failed.value.plan.verified
    assert not failed.value.plan.verify().passed


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "plan.h5").write_text("text")
    with pytest.raises(PlanFileError, match="not an HDF5 file"):
        climbplan.load_plan(tmp_path)
    with pytest.raises(PlanFileError, match="no such file"):
        climbplan.load_plan(tmp_path / "none.h5")


@pytest.mark.parametrize(
    ("spec", "array", "shape"),
    [
        ("bookshelf_scene", "solution/pose", (1, 4, 3)),
        ("transition_flat", "rounds/com", (3, 3)),
    ],
)
def test_other_kinds(spec: str, array: str, shape: tuple[int, ...]) -> None:
    plan = climbplan.plan(SPECS / f"{spec}.yaml")
    assert plan[array].shape == shape
    assert plan.verify().passed
    assert plan.to_csv().count("\n") > 1
    if plan.kind == "bookshelf":
        with pytest.raises(UsageError, match="bookshelf: expected a climb or transition"):
            plan.executive()


def test_a_problem_of_ones_own() -> None:
    theta = {"start": [0.0, 0.2, 0.0]}
    found = climbplan.solve(tipped_box.scheduled, theta, method="nlp", time_limit=30.0)
    assert found.status == "feasible"
    assert found["pose"].shape == (tipped_box.KNOTS + 1, 3)
    assert found.check().passed(1e-6)
    assert found.bound == -np.inf
    assert "by nlp" in repr(found)
    with pytest.raises(UsageError, match="unknown method"):
        climbplan.solve(tipped_box.problem, theta, method="simplex")
    with pytest.raises(UsageError, match="did you mean 'time_limit'"):
        climbplan.solve(tipped_box.problem, theta, timelimit=3.0)


def test_a_bare_program_is_a_problem() -> None:
    p = climbplan.Program("square")
    x = p.continuous("x", (1,), 1.0, 2.0)
    p.minimise("size", x[0] ** 2)
    assert climbplan.solve(p).objective == pytest.approx(1.0, abs=1e-4)
