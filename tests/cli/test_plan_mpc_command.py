"""`plan-mpc` from spec to files, streams and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest
from command_line import RunCommand

SPECS = Path(__file__).parents[2] / "specs"
FEW = ["-s", "solver.gaits=1", "--time-limit", "30"]


@pytest.mark.parametrize("name", ["mpc_disturbance", "mpc_turn", "mpc_stairs"])
def test_shipped_tasks_are_planned(run_command: RunCommand, workplace: Path, name: str) -> None:
    done = run_command("plan-mpc", str(SPECS / f"{name}.yaml"), *FEW)
    assert done.code == 0, done.err
    assert done.out == f"outputs/{name}/plan.h5\n"
    assert "verify    passed" in done.err
    made = {entry.name for entry in (workplace / "outputs" / name).iterdir()}
    assert made == {"plan.h5", "report.json", "report.html", "figures"}


def test_report_verify_export(run_command: RunCommand, workplace: Path) -> None:
    spec = str(SPECS / "mpc_forward.yaml")
    options = ["--method", "mpcc", "--time-limit", "60", "-o", "walk", "--json"]
    done = run_command("plan-mpc", spec, *options)
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert report["verified"] is True
    assert report["method"] == "mpcc"
    assert len(report["gait"]["contact"]) == 9
    figures = {path.name for path in (workplace / "walk" / "figures").iterdir()}
    assert figures == {"tracking.png", "gait.png", "snapshots.png"}
    assert "dynamics.angular_velocity" in run_command("verify", "walk").out
    assert run_command("export", "walk").out == "walk/walk.csv\n"
    with h5py.File(workplace / "walk" / "plan.h5", "r+") as file:
        file["force"][0, 0, 2] += 1.0
    assert run_command("verify", "walk").code == 5


def test_bad_values_and_no_plan(run_command: RunCommand) -> None:
    spec = str(SPECS / "mpc_forward.yaml")
    done = run_command("plan-mpc", spec, "--method", "magic")
    assert done.code == 2
    assert "solver.method" in done.err
    thrown = ["-s", "task.start.velocity=[0, 0, -5]", "-s", "task.knots=3"]
    done = run_command("plan-mpc", spec, *thrown, *FEW, "-o", "none")
    assert done.code == 4
    assert "no plan found" in done.err
    assert not Path("none").exists()


@pytest.mark.slow
def test_closed_loop_and_its_library(run_command: RunCommand, workplace: Path) -> None:
    spec = str(SPECS / "mpc_recovery.yaml")
    small = ["-s", "library.size=2", "-s", "library.gaits=0", "-s", "loop.duration=1.28"]
    done = run_command("plan-mpc", spec, *small, "-o", "loop", "--json")
    assert done.code == 0, done.err
    online = json.loads(done.out)["online"]
    assert online["ticks"] == 17  # 16 knots, and one when the push was felt
    assert online["pushes"][0]["velocity"] == [-1.5, 0.0, 0.0]
    with h5py.File(workplace / "loop" / "plan.h5") as file:
        assert file.attrs["integrator"] == "rk4"
        samples = len(file["time"])
        for name in ("solve_time", "tick_time", "candidates_tried", "winner"):
            assert file[name].shape == (samples,)
    again = ["-s", "library.file=loop/library.h5"]
    more = run_command("plan-mpc", spec, "-s", "library.size=9", *again, "-o", "more")
    assert more.code == 2
    assert "library.size asks for 9" in more.err
    assert run_command("plan-mpc", spec, "-s", "task.integrator=euler").code == 2
    fall = ["-s", "loop.pushes=[{time: 0.5, velocity: [0, -6, 0]}]"]
    fell = run_command("plan-mpc", spec, *small, *again, *fall, "-o", "fall")
    assert fell.code == 5
    assert "the robot fell" in fell.err
