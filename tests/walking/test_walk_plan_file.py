"""MPC plans as files: written, read back, verified, and tampered with."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.errors import LimitReached, PlanFileError
from climbplan.walking.check.verification import verify, verify_and_mark
from climbplan.walking.exports.table import export_csv
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc

SPEC = """\
kind: mpc
title: A short walk
task: {knots: 4, integrator: mean, start: {velocity: [1, 0, 0]}}
solver: {time_limit: 60, gaits: 8}
"""


@pytest.fixture(scope="module")
def plan_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    (folder / "short.yaml").write_text(SPEC)
    path = folder / "plan.h5"
    write_walk_plan(plan_walk(load_mpc(folder / "short.yaml")), path)
    assert verify_and_mark(path).passed
    return path


def test_read_back_exactly(plan_path: Path, tmp_path: Path) -> None:
    plan = read_walk_plan(plan_path)
    assert plan.verified
    write_walk_plan(plan, tmp_path / "again.h5")
    again = read_walk_plan(tmp_path / "again.h5")
    for name in ("state", "toes", "force"):
        np.testing.assert_array_equal(
            getattr(plan.trajectory, name), getattr(again.trajectory, name)
        )
    assert again.terms == plan.terms
    assert again.history == plan.history
    assert again.task.knots == 4


def test_a_robot_of_ones_own_is_kept_in_the_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths start at the spec; verification needs the plan file alone, from anywhere."""
    shipped = files("climbplan").joinpath("robots", "bodies", "scaler.yaml").read_text()
    folder, elsewhere = tmp_path / "there", tmp_path / "elsewhere"
    (folder / "robots").mkdir(parents=True)
    elsewhere.mkdir()
    (folder / "robots" / "heavy.yaml").write_text(shipped.replace("mass: 6.3", "mass: 6.6"))
    (folder / "heavy.yaml").write_text(SPEC + "robot: robots/heavy.yaml\n")
    monkeypatch.chdir(elsewhere)
    path = elsewhere / "plan.h5"
    write_walk_plan(plan_walk(load_mpc(folder / "heavy.yaml")), path)
    (folder / "robots" / "heavy.yaml").unlink()
    assert verify(path).passed
    assert "6.6" in read_walk_plan(path).robot_text
    with h5py.File(path, "r+") as file:
        file["robot"].attrs["source"] = shipped
    assert not verify(path).passed
    with h5py.File(path, "r+") as file:
        file["robot"].attrs["source"] = "kind: rigid-body"
    assert not verify(path).passed


def test_a_robot_path_of_an_option_starts_where_the_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = files("climbplan").joinpath("robots", "bodies", "scaler.yaml").read_text()
    (tmp_path / "specs").mkdir()
    (tmp_path / "specs" / "short.yaml").write_text(SPEC)
    (tmp_path / "own.yaml").write_text(shipped.replace("mass: 6.3", "mass: 6.6"))
    monkeypatch.chdir(tmp_path)
    assert load_mpc("specs/short.yaml", ["robot=own.yaml"]).robot.mass == 6.6


def test_layout_that_others_rely_on(plan_path: Path) -> None:
    with h5py.File(plan_path) as file:
        assert file.attrs["format"] == "climbplan/mpc"
        assert file.attrs["integrator"] == "mean"
        assert file["toes"].shape == (5, 4, 3)
        assert file["force"].attrs["units"] == "N"
        robot = file["robot"].attrs
        assert robot["inertia"].shape == (3, 3)
        assert {"mass", "friction", "force_limit"} <= set(robot)
        assert file["reference/velocity"].shape == file["reference/euler_zyx"].shape == (5, 3)


def shift_force(file: h5py.File) -> None:
    file["force"][1, :, 0] += 1.0


def other_text(file: h5py.File) -> None:
    file.attrs["spec"] = file.attrs["spec"].replace("short", "long")


def cheaper(file: h5py.File) -> None:
    file.attrs["objective"] = 0.5 * file.attrs["objective"]


def other_start(file: h5py.File) -> None:
    file["start/state"][3] = 0.5


def not_a_number(file: h5py.File) -> None:
    file["com"][2, 1] = np.nan


@pytest.mark.parametrize(
    ("change", "check"),
    [
        (shift_force, "dynamics.velocity"),
        (other_text, "file.spec_hash"),
        (cheaper, "file.objective"),
        (other_start, "file.spec_values"),
        (not_a_number, "file.finite"),
    ],
)
def test_tampering_is_found(
    plan_path: Path, tmp_path: Path, change: Callable[[h5py.File], None], check: str
) -> None:
    copy = tmp_path / "copy.h5"
    copy.write_bytes(plan_path.read_bytes())
    with h5py.File(copy, "r+") as file:
        change(file)
    assert check in {item.name for item in verify(copy).failed}


def test_damage_is_named(plan_path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.h5"
    copy.write_bytes(plan_path.read_bytes())
    with h5py.File(copy, "r+") as file:
        del file["toes"]
    with pytest.raises(PlanFileError, match="toes is missing"):
        verify(copy)


def test_csv(plan_path: Path, tmp_path: Path) -> None:
    export_csv(plan_path, tmp_path / "walk.csv")
    lines = (tmp_path / "walk.csv").read_text().splitlines()
    assert len(lines) == 6
    assert lines[0].startswith("time_s,com_x_m")
    assert len(lines[1].split(",")) == len(lines[0].split(",")) == 1 + 12 + 24 + 4


def test_no_plan_says_why(tmp_path: Path) -> None:
    """The body is thrown down faster than legs can stop it."""
    text = SPEC.replace("velocity: [1, 0, 0]", "velocity: [0, 0, -4]")
    (tmp_path / "fall.yaml").write_text(text)
    with pytest.raises(LimitReached, match=r"tried [0-9]+ gaits"):
        plan_walk(load_mpc(tmp_path / "fall.yaml"))
