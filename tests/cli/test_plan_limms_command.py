"""`climbplan plan-limms` as users run it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RunCommand

SPECS = Path(__file__).parents[2] / "specs"


def test_lift_is_planned_verified_and_reported(tmp_path: Path, run_command: RunCommand) -> None:
    out = tmp_path / "lift"
    done = run_command("plan-limms", str(SPECS / "limms_lift_light.yaml"), "--out", str(out))
    assert done.code == 0, done.err
    assert done.out == f"{out}/plan.h5\n"
    assert "arms: left to +y, right to -y" in done.err
    assert {p.name for p in out.iterdir()} == {"plan.h5", "report.json", "report.html", "figures"}
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["verified"]
    assert [name for name, _ in report["box"]["modes"]] == ["stable", "manipulated"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "replay-data" in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")
    assert run_command("verify", str(out)).code == 0
    table = tmp_path / "motion.csv"
    assert run_command("export", str(out), "--out", str(table)).code == 0
    assert table.read_text(encoding="utf-8").startswith("time_s,box_mode,box_x_m")


def test_forced_arms_are_refused_with_the_shortfall(
    tmp_path: Path, run_command: RunCommand
) -> None:
    done = run_command(
        "plan-limms", str(SPECS / "limms_lift_light.yaml"), "--out", str(tmp_path / "out"),
        "--set", "box.mass=7", "--set", "task.allow=[arms]",
    )  # fmt: skip
    assert done.code == 3
    assert "28.7 N short" in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("assignment", "code", "words"),
    [
        ("box.goal=[0, 0, 1]", 2, "box.goal"),
        ("terrain.anchors.0.position=[-0.2, 0, 0.7]", 2, "anchor 'wall' is outside"),
        ("static_boxes=[{size: [0.2, 0.2, 0.2], position: [0.8, 0, 0.1]}]", 2, "overlaps the box"),
        ("modules.0.position=[0.7, 0.05, 0]", 2, "is in the box at its start"),
        ("task.allow=[quadruped]", 2, "a quadruped needs 4 modules, got 1"),
        ("box.mass=3", 3, "9.4 N short"),
        ("box.start=[2.2, 0, 0.1]", 3, "no module reaches the box"),
    ],
)
def test_what_cannot_be_planned_is_named(
    tmp_path: Path, run_command: RunCommand, assignment: str, code: int, words: str
) -> None:
    done = run_command(
        "plan-limms", str(SPECS / "limms_throw.yaml"), "--out", str(tmp_path / "out"),
        "--set", assignment,
    )  # fmt: skip
    assert done.code == code, done.err
    assert words in done.err
    assert not (tmp_path / "out").exists()
