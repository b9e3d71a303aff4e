"""`climbplan plan-transition`: output, exit codes, messages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RunCommand

SPECS = Path(__file__).parents[2] / "specs"
FLAT = str(SPECS / "transition_flat.yaml")


def test_a_plan_and_its_report(run_command: RunCommand, workplace: Path) -> None:
    outcome = run_command("plan-transition", FLAT, "-o", "out")
    assert outcome.code == 0, outcome.err
    assert outcome.out == "out/plan.h5\n"
    assert "3-3: " in outcome.err
    report = json.loads((workplace / "out/report.json").read_text())
    assert report["format"] == "climbplan/transition"
    assert report["verified"] is True
    assert len(report["sequences"]) == 2
    assert (workplace / "out/figures/schedule.png").stat().st_size > 1000
    assert "Contact sequences found" in (workplace / "out/report.html").read_text()
    assert run_command("verify", "out").code == 0
    assert run_command("export", "out").out == "out/trajectory.csv\n"


def test_a_sequence_sets_the_rounds(run_command: RunCommand, workplace: Path) -> None:
    options = ("-s", "search.heights=2", "-s", "search.max_sequences=5")
    outcome = run_command("plan-transition", FLAT, "--sequence", "2-2-2", "-o", "out", *options)
    assert outcome.code == 0, outcome.err
    assert "2-2-2: " in outcome.err
    assert "3 rounds" in outcome.err


@pytest.mark.parametrize(
    ("override", "code", "words"),
    [
        ("terrain.walls.gap=1.5", 4, "the walls are 1.5 m apart"),
        ("task.goal.com=[0, 0, 0.9]", 4, "RM reaches its goal from no pose"),
        ("task.goal.com=[0, 0, 3.5]", 3, "cannot reach any place where it may stand"),
        ("task.min_supporting_limbs=6", 2, "none can move"),
        (
            "terrain.boxes=[{name: brick, lower: [-0.4, 0.2, 0], upper: [-0.2, 0.6, 0.09]}]",
            2,
            "LF is covered by 'brick'",
        ),
        (
            "terrain.obstacles=[{name: ceiling, lower: [-0.6, -1, 0.39], upper: [0.6, 1, 0.5]}]",
            4,
            "clear of 'ceiling'",
        ),
        ("force.safety_friction=3", 4, "no contact sequence"),
        ("task.step_max={LF: 0.1}", 4, "mm at least on the footholds searched, and may step 100"),
        pytest.param("search.min_load=0.4", 4, "does not balance on", marks=pytest.mark.slow),
        ("solver.time_limit=0.0001", 4, "time limit"),
        ("climb={rounds: 1, goal: {com: [0, 0, 1.2]}}", 4, "climb, 1 round: RF's way to its goal"),
    ],
)
def test_what_cannot_be_is_named(
    run_command: RunCommand, workplace: Path, override: str, code: int, words: str
) -> None:
    options = () if "time_limit" in override else ("-s", "solver.time_limit=25")
    outcome = run_command("plan-transition", FLAT, "-o", "out", "-s", override, *options)
    assert outcome.code == code, outcome.err
    assert words in outcome.err
    assert not (workplace / "out").exists()
