"""simulate on a plan: what it prints and writes, and what it refuses."""

from __future__ import annotations

import csv
import importlib
import json
import shutil
from pathlib import Path

import h5py
import pytest
from command_line import RunCommand

from climbplan.cli.simulate_options import SimulateOptions, build_request
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_text
from climbplan.simulation.report_files import SimulationEnd

SMALL_CLIMB = Path(__file__).parents[1] / "schema" / "small_climb.yaml"
SHORT = (
    "task.rounds=1", "task.goal.com=[0,0,0.04]", "task.goal.toes={}", "study=null",
    "trajectory.speed=0.01",
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan file of one round."""
    path = tmp_path_factory.mktemp("made") / "plan.h5"
    write_climb(plan_climb(load_text(SMALL_CLIMB.read_text(), "small", SHORT)), path)
    return path


@pytest.fixture
def plan(workplace: Path, made: Path) -> Path:
    """The directory `made` with that plan."""
    (workplace / "made").mkdir()
    shutil.copy(made, workplace / "made")
    return workplace / "made"


@pytest.mark.parametrize(
    "options", [("--regulate", "joints"), ("--engine", "statics"), ("--speed", "2")]
)
def test_closed_loop_has_a_pace_and_feedback_of_its_own(
    run_command: RunCommand, plan: Path, options: tuple[str, ...]
) -> None:
    done = run_command("simulate", plan.name, "--closed-loop", *options)
    assert done.code == 2
    assert "--closed-loop: expected --engine mujoco, and no --regulate or --speed" in done.err


def test_quasi_static_steps_are_of_worlds(run_command: RunCommand, plan: Path) -> None:
    done = run_command("simulate", plan.name, "--engine", "statics")
    assert done.code == 2
    assert "--engine statics: expected --worlds N beside it" in done.err


def test_replans_are_of_closed_loop(run_command: RunCommand, plan: Path) -> None:
    done = run_command("simulate", plan.name, "--replans", "1")
    assert done.code == 2
    assert "--replans 1: expected --closed-loop as well" in done.err


@pytest.mark.parametrize(("replans", "expected"), [(None, 2), (0, 0), (5, 5)])
def test_replans_reach_the_conditions(replans: int | None, expected: int) -> None:
    options = SimulateOptions(plan=Path("plan.h5"), closed_loop=True, replans=replans)
    assert build_request(options, ("", ())).conditions.max_replans == expected


@pytest.mark.merge
def test_simulate_executes_a_climb_in_closed_loop(
    run_command: RunCommand, workplace: Path, plan: Path
) -> None:
    pytest.importorskip("mujoco")
    done = run_command("simulate", plan.name, "--closed-loop", "--replans", "1", "--no-pictures")
    assert done.code == 0, done.err
    assert "no fall in closed loop" in done.err
    report = json.loads((workplace / "outputs" / "small_simulation" / "report.json").read_text())
    kinds = {event["kind"] for event in report["execution"]["events"]}
    assert {"touched", "forces"} <= kinds
    assert report["execution"]["stopped"] == ""
    assert report["execution"]["duration"] > report["planned_time"]


def test_simulate_writes_table_report_and_figures(
    run_command: RunCommand, workplace: Path, plan: Path
) -> None:
    pytest.importorskip("mujoco")
    done = run_command("simulate", "made", "--no-pictures", "--runs", "1", "--speed", "2")
    assert (done.code, done.out) == (0, "outputs/small_simulation/simulation.csv\n"), done.err
    assert "no fall" in done.err
    folder = workplace / "outputs" / "small_simulation"
    report = json.loads((folder / "report.json").read_text())
    assert report["fallen"] is False
    assert report["torque"]["relative_error"]["median"] < 0.25
    assert len(report["runs"]) == 1
    rows = list(csv.DictReader((folder / "simulation.csv").read_text().splitlines()))
    assert len(rows) == 6 * 5 + 6 * 6
    assert {p.name for p in (folder / "figures").iterdir()} == {
        *(f"leg_{limb}.png" for limb in range(1, 7)),
        "sag.png",
    }
    assert "no fall" in (folder / "report.html").read_text()
    again = run_command("simulate", "made", "--no-pictures")
    assert again.code == 2
    assert "--force" in again.err


def test_refusals(
    run_command: RunCommand, workplace: Path, plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "expected KEY=V1" in run_command("simulate", "made", "--sweep", "a").err
    for option, value in (
        ("--payload", "nan"), ("--payload", "-20"), ("--gain", "inf"), ("--speed", "inf"),
        ("--seed", "-4"), ("--regulate", "height"),
    ):  # fmt: skip
        refused = run_command("simulate", "made", "--no-pictures", option, value)
        assert refused.code == 2, refused.err
        assert option in refused.err
    assert run_command("simulate", "none").code == 2
    with h5py.File(workplace / "shelf.h5", "w") as file:
        file.attrs["format"] = "climbplan/bookshelf"
    shelf = run_command("simulate", "shelf.h5")
    assert shelf.code == 2
    assert "'climbplan/bookshelf'" in shelf.err
    assert "climbs, transitions, walks and modules" in shelf.err
    found = importlib.import_module

    def without(name: str, package: str | None = None) -> object:
        if name == "mujoco":
            raise ImportError(name)
        return found(name, package)

    monkeypatch.setattr("climbplan.simulation.mujoco_loading.import_module", without)
    missing = run_command("simulate", "made")
    assert missing.code == 2
    assert "pip install 'climbplan[simulate]'" in missing.err
    assert not (workplace / "outputs").exists()


def test_the_second_engine_says_what_it_needs(
    run_command: RunCommand, workplace: Path, plan: Path
) -> None:
    pytest.importorskip("pydrake")
    drake = ("simulate", "made", "--engine", "drake")
    refused = run_command(*drake)
    assert (refused.code, refused.out) == (2, "")
    assert "is not from a URDF" in refused.err
    assert "--armature =VALUE" in run_command(*drake, "--armature", "2").err
    assert "no option of other engines" in run_command(*drake, "--runs", "3").err
    assert "go with --engine drake" in run_command("simulate", "made", "--sphere-toes").err
    assert not (workplace / "outputs" / "small_drake").exists()


def test_a_fall_ends_with_five(run_command: RunCommand, workplace: Path, plan: Path) -> None:
    pytest.importorskip("mujoco")
    icy = ("simulate", "made", "--no-pictures", "--friction", "0.05", "--speed", "2", "--force")
    done = run_command(*icy)
    assert (done.code, done.out) == (5, "outputs/small_simulation/simulation.csv\n"), done.err
    assert done.err.splitlines()[-1].startswith("error: the robot falls at ")
    told = json.loads(run_command(*icy, "--json").out)
    assert (told["exit_code"], told["status"], told["stage"]) == (5, "unverified", "simulate")
    assert told["fell"] is True
    assert 0 <= told["fall_time"] <= told["planned_time"]
    assert told["plan"] == "made/plan.h5"
    assert told["file"] == "outputs/small_simulation/simulation.csv"
    study = run_command(*icy, "--allow-falls", "--json")
    assert study.code == 0
    assert json.loads(study.out)["fell"] is True


@pytest.mark.parametrize(
    ("end", "most", "words"),
    [
        (SimulationEnd(None, 0, 0, 0), None, ""),
        (SimulationEnd(None, 1, 0, 0), None, "stands with 1 slip"),
        (SimulationEnd(None, 1, 2, 0), None, "stands with 1 slip and 2 lost contacts"),
        (SimulationEnd(None, 1, 2, 0), 2, "expected at most 2 together (--most-slips)"),
        (SimulationEnd(None, 1, 2, 0), 3, ""),
        (SimulationEnd(None, 0, 4, 4), None, ""),
        (SimulationEnd(None, 0, 5, 4), None, "5 lost contacts"),
        (SimulationEnd(3.2, 0, 0, 0), 100, "falls at 3.20 s"),
    ],
)
def test_what_counts_as_a_failure(end: SimulationEnd, most: int | None, words: str) -> None:
    said = end.failure(most)
    assert words in said
    assert bool(said) == bool(words)
