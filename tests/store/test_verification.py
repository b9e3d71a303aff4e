"""Verification of sound plans, its report, and the mark it leaves in the file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from example_climb import SPEC, Climb, example_climb

from climbplan.climb.check.verification import verify, verify_and_mark
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.errors import PlanFileError
from climbplan.verification.check import LIMITS
from climbplan.verification.verification import Verification, mark_verified

NONPARALLEL = """
kind: climb
robot: hexapod
terrain:
  friction: 1.2
  walls: {gap: 1.25, angle_deg: 10, along: [-0.8, 0.8], up: [-1.0, 1.5]}
task:
  rounds: 1
  gait: [LM, RF, RR, LR, RM, LF]
  start: {com: [0.02, 0.01, 0.0], rpy_deg: [3.0, -2.0, 5.0]}
  goal: {com: [-0.02, 0.03, 0.09], rpy_deg: [-2.0, 2.0, -3.0]}
force: {safety_friction: 1.5}
"""
TUBE = """
kind: climb
robot: hexapod
terrain: {friction: 1.1, tube: {radius: 0.68, center: [0.01, -0.02], up: [-1.0, 1.5]}}
task:
  rounds: 1
  start: {com: [0.0, 0.0, 0.0]}
  goal: {com: [0.0, 0.0, 0.08], rpy_deg: [0.0, 0.0, 5.0]}
solver: {method: nlp}
"""
REGIONS = """
kind: climb
robot: hexapod
terrain:
  friction: 0.5
  regions:
    - name: right
      friction: 1.3
      limbs: [RF, RM, RR]
      rectangle: {center: [0.61, 0.0, 0.0], normal: [-2.0, 0.0, 0.1], width: 1.2, height: 1.6}
    - name: left
      friction: 1.2
      vertices: [[-0.6, -0.7, -0.8], [-0.6, 0.7, -0.8], [-0.6, 0.0, 1.9]]
  free_regions:
    - {name: all, lower: [-0.4, -0.6, -1.0], upper: [0.4, 0.6, 1.0]}
task:
  rounds: 1
  start: {com: [0.0, 0.0, 0.0]}
  goal: {com: [0.0, 0.01, 0.08]}
"""


def verified(climb: Climb, directory: Path) -> Verification:
    write_climb(climb.plan, directory / "plan.h5")
    return verify(directory / "plan.h5")


def test_a_sound_plan_passes_every_check(original: Path) -> None:
    verification = verify(original)
    assert verification.passed, verification.table()
    assert [check.name for check in verification.checks] == list(LIMITS)
    residual = {check.name: check.residual for check in verification.checks}
    for name in (
        "force.equilibrium",
        "kinematics.forward",
        "torque.from_forces",
        "stiffness.force_deflection",
    ):
        assert residual[name] < 1e-12


@pytest.mark.parametrize("text", [NONPARALLEL, TUBE, REGIONS], ids=["angle", "tube", "regions"])
def test_other_terrains_and_gaits_pass(text: str, tmp_path: Path) -> None:
    verification = verified(example_climb(spec_text=text), tmp_path)
    assert verification.passed, verification.table()


def test_more_rounds_pass(tmp_path: Path) -> None:
    verification = verified(example_climb(rounds=4, per_segment=3), tmp_path)
    # Three samples a segment are faster than the joints.
    assert {check.name for check in verification.failed} <= {"speed.limit"}


def test_report_names_margins_and_places(original: Path) -> None:
    verification = verify(original)
    lines = verification.table().splitlines()
    assert len(lines) == len(verification.checks) + 1
    assert lines[0].split()[:4] == ["check", "residual", "limit", "unit"]
    friction = next(line for line in lines if line.startswith("force.friction"))
    assert "S_mu 1.80" in friction
    assert "round " in friction
    assert friction.index("1e-06") == lines[0].index("limit")
    # The robot is neither built in nor carried, nothing is asked of how deep commands press, and
    # the example was made without margins: two of them it does not keep.
    told = {check.name for check in verification.checks if not check.judged}
    assert {name for name in told if name.startswith("robust.")} == {
        "robust.friction",
        "robust.depth",
    }
    first = f"{len(LIMITS)} checks, 4 not judged, worst margin: force.friction"
    assert verification.headline().startswith(first)


def test_failures_come_first_and_are_named(plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        file["instants/joint_torques"][3, 1, 2] += 1.0
    verification = verify(plan_file)
    assert not verification.passed
    first = verification.table().splitlines()[1]
    assert first.startswith("torque.from_forces")
    assert "FAILED" in first
    assert first.endswith("round 1, push 2, RM tibia")
    assert verification.headline() == (
        f"1 of {len(LIMITS)} checks failed, worst: torque.from_forces, round 1, push 2, RM tibia"
    )


def test_report_is_json_even_when_nothing_is_finite(plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        file["trajectory/contact"][...] = True
    report = json.loads(json.dumps(verify(plan_file).as_dict(), allow_nan=False))
    assert report["passed"] is False
    by_name = {check["name"]: check for check in report["checks"]}
    assert by_name["trajectory.instants"]["residual"] is None
    assert by_name["force.equilibrium"]["unit"] == "of weight"


def test_the_outcome_is_written_into_the_file(plan_file: Path) -> None:
    before = read_climb(plan_file)
    assert verify_and_mark(plan_file).passed
    assert read_climb(plan_file).verified
    assert verify(plan_file).passed
    with h5py.File(plan_file, "r+") as file:
        file["instants/force"][1, 1, 0] += 1.0
    assert not verify_and_mark(plan_file).passed
    assert not read_climb(plan_file).verified
    assert read_climb(plan_file).spec_text == before.spec_text
    assert os.listdir(plan_file.parent) == ["plan.h5"]


def test_marking_keeps_the_file_if_it_cannot_be_done(
    plan_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    verification = verify(plan_file)
    content = plan_file.read_bytes()

    def broken(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(Exception, match="No space left on device"):
        mark_verified(plan_file, verification)
    assert plan_file.read_bytes() == content
    assert os.listdir(plan_file.parent) == ["plan.h5"]


def test_what_is_no_plan_is_refused(tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(SPEC)
    with pytest.raises(PlanFileError, match="not an HDF5 file"):
        verify(tmp_path / "spec.yaml")


def test_verification_does_not_touch_the_planner() -> None:
    code = (
        "import sys, climbplan.climb.check.verification\n"
        "used = ('robots.kinematics', 'mechanics', 'climb.', 'solvers', 'program')\n"
        "own = ('climbplan.climb.check', 'climbplan.climb.plan', 'climbplan.climb.schema')\n"
        "print([m for m in sys.modules if m.startswith(tuple('climbplan.' + u for u in used))"
        " and m.split('.')[:3] not in [o.split('.') for o in own]])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
