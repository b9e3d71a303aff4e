"""report.json: complete, valid, and true to the plan; files written whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from climbplan.climb.check.verification import verify
from climbplan.climb.pages.figures import UNITS, compute_key_figures
from climbplan.climb.pages.report import build_report, write_report
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.climb.plan.file import write_climb
from climbplan.errors import PlanFileError, UsageError

MakePlan = Callable[..., ClimbPlan]
ROOT = ("format", "format_version", "climbplan_version", "created", "spec", "spec_sha256", "seed")
ROOT += ("status", "objective", "bound", "gap", "timings", "solvers")


def strict_json(text: str) -> Any:
    """JSON without NaN and infinities."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def study() -> Study:
    grid = np.array([0.5, 1.0]), np.array([0.0, 2.0, 4.0])
    label = np.array([[1, 1, 1], [0, 0, 2]])
    detail = ("round 1: friction at RF",) * 3 + ("", "", "too far")
    return Study(("terrain.friction", "task.payload.mass"), grid, label, detail)


@pytest.fixture(scope="module")
def written(
    make_plan: MakePlan, study: Study, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ClimbPlan, Path]:
    """A plan and the directory of its report."""
    directory = tmp_path_factory.mktemp("report")
    plan = make_plan(6, 2, study=study)
    write_climb(plan, directory / "plan.h5")
    write_report(directory / "plan.h5", directory)
    return plan, directory


def test_the_directory_holds_the_report_and_nothing_else(written: tuple[ClimbPlan, Path]) -> None:
    _, directory = written
    found = {str(p.relative_to(directory)) for p in directory.rglob("*") if p.is_file()}
    names = ("postures", "torque", "friction", "safety", "forces", "region")
    figures = {f"figures/{name}.png" for name in names}
    assert found == {"plan.h5", "report.json", "report.html", *figures}
    report = strict_json((directory / "report.json").read_text())
    assert set(report["figures"]) == figures


def test_root_attributes_are_repeated(written: tuple[ClimbPlan, Path]) -> None:
    _, directory = written
    report = strict_json((directory / "report.json").read_text())
    with h5py.File(directory / "plan.h5") as file:
        for name in ROOT:
            stored = file.attrs[name]
            if name in ("timings", "solvers"):
                stored = json.loads(stored)
            assert report[name] == stored, name


def test_verification_is_made_anew(written: tuple[ClimbPlan, Path]) -> None:
    plan, directory = written
    report = build_report(directory / "plan.h5")
    made = verify(directory / "plan.h5")
    assert report["verification"] == [check.as_dict() for check in made.checks]
    for row in made.checks:
        keys = {"name", "residual", "limit", "unit", "passed", "worst_at"}
        assert keys <= set(row.as_dict())
    # The made-up forces do not balance, whatever the file's attribute says.
    assert plan.verified
    assert report["verified"] is False
    assert report == strict_json((directory / "report.json").read_text())


def test_key_figures_are_those_of_the_plan(make_plan: MakePlan, study: Study) -> None:
    plan = make_plan(6, 4, study=study)
    figures = compute_key_figures(plan)
    assert figures["climb"]["rounds"] == 4
    assert figures["climb"]["instants"] == 48
    assert figures["climb"]["height"] == pytest.approx(0.4)
    assert figures["climb"]["path"] == pytest.approx(0.4)
    assert figures["climb"]["duration"] == pytest.approx(plan.trajectory.time[-1])
    assert figures["sag"] == pytest.approx({"least": 0.02, "most": 0.02})
    assert figures["penetration"] == pytest.approx({"least": 0.03, "most": 0.03})
    assert figures["load"]["payload"] == 0.0
    torques = np.abs(plan.forces.joint_torques)
    worst = figures["worst_torque"]
    assert worst["torque"] == torques.max()
    limb = plan.robot.limb_names.index(worst["limb"])
    joint = ("coxa", "femur", "tibia").index(worst["joint"])
    assert torques[worst["instant"], limb, joint] == torques.max()
    least = figures["safety"]["torque"]
    assert least["least"] == pytest.approx(25.0 / torques.max())
    slip = figures["safety"]["friction"]
    assert slip["least"] == plan.forces.safety_friction.min()
    assert slip["mu"] / slip["mu_critical"] == pytest.approx(slip["least"])
    assert slip["where"] == plan.instants.label(slip["instant"], plan.robot.limb_names)
    assert figures["study"]["counts"] == {
        "feasible": 2,
        "force-infeasible": 3,
        "kinematics-infeasible": 1,
    }
    axes = figures["study"]["axes"]
    assert [axis["unit"] for axis in axes] == ["", "kg"]
    assert [axis["own"] for axis in axes] == [1.0, 0.0]


def test_units_name_keys_that_are_there(make_plan: MakePlan) -> None:
    plan = make_plan(6, 1)
    figures = {**compute_key_figures(plan), "timings": plan.timings}
    for key, unit in UNITS.items():
        assert unit
        here: Any = figures
        for part in key.split("."):
            if part == "*":
                assert isinstance(here, dict)
                break
            here = here[part]


def test_an_unloaded_instant_is_null_not_infinity(make_plan: MakePlan, tmp_path: Path) -> None:
    plan = make_plan(6, 1)
    nothing = {
        "force": 0.0 * plan.forces.force,
        "joint_torques": 0.0 * plan.forces.joint_torques,
        "mu_critical": 0.0 * plan.forces.mu_critical,
        "safety_torque": np.full(plan.instants.count, np.inf),
        "safety_friction": np.full(plan.instants.count, np.inf),
    }
    write_climb(replace(plan, forces=replace(plan.forces, **nothing)), tmp_path / "plan.h5")
    write_report(tmp_path / "plan.h5", tmp_path)
    report = strict_json((tmp_path / "report.json").read_text())
    assert report["safety"]["torque"]["least"] is None
    assert report["safety"]["friction"]["least"] is None


def test_odd_values_in_a_file_do_not_break_the_report(make_plan: MakePlan, tmp_path: Path) -> None:
    plan = make_plan(3, 1)
    airborne = replace(plan.instants, contact=np.zeros_like(plan.instants.contact))
    write_climb(replace(plan, sizes={"a": [1, 2.5]}, instants=airborne), tmp_path / "plan.h5")
    write_report(tmp_path / "plan.h5", tmp_path)
    report = strict_json((tmp_path / "report.json").read_text())
    assert report["normal_force"] == {"least": None, "most": None}


@pytest.mark.parametrize(
    ("timings", "words"),
    [
        ('{"posture": NaN}', "holds NaN, a number that is not finite"),
        ('{"posture": "soon"}', "'posture' is 'soon', not a number"),
        ('{"posture": {"cell": 1.0}}', "not a number"),
    ],
)
def test_attributes_of_another_kind_are_refused(
    make_plan: MakePlan, tmp_path: Path, timings: str, words: str
) -> None:
    write_climb(make_plan(3, 1), tmp_path / "plan.h5")
    with h5py.File(tmp_path / "plan.h5", "r+") as file:
        file.attrs["timings"] = timings
    with pytest.raises(PlanFileError, match=words):
        write_report(tmp_path / "plan.h5", tmp_path)


def test_a_spec_of_another_version_only_leaves_gaps(make_plan: MakePlan) -> None:
    plan = make_plan(6, 1)
    document = yaml.safe_load(plan.spec_text)
    document["from_the_future"] = 1
    figures = compute_key_figures(replace(plan, spec_text=yaml.safe_dump(document)))
    assert figures["load"]["payload"] is None
    assert figures["climb"]["height"] == pytest.approx(0.1)
    assert compute_key_figures(replace(plan, spec_text="{"))["load"]["payload"] is None


def test_mistakes_have_named_errors(make_plan: MakePlan, tmp_path: Path) -> None:
    with pytest.raises(PlanFileError, match="no such file"):
        write_report(tmp_path / "none.h5", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    write_climb(make_plan(3, 1), tmp_path / "plan.h5")
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(UsageError, match="cannot be written"):
        write_report(tmp_path / "plan.h5", tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "a file"


def test_a_report_takes_the_place_of_an_old_one(make_plan: MakePlan, tmp_path: Path) -> None:
    write_climb(make_plan(3, 1, name="first"), tmp_path / "plan.h5")
    write_report(tmp_path / "plan.h5", tmp_path)
    write_climb(make_plan(3, 1, name="second"), tmp_path / "plan.h5")
    write_report(tmp_path / "plan.h5", tmp_path, verify(tmp_path / "plan.h5"))
    assert strict_json((tmp_path / "report.json").read_text())["name"] == "second"
    assert not list(tmp_path.rglob("*.part"))
