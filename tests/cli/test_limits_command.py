"""`limits` from spec to files, streams and exit codes."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from command_line import RunCommand

from climbplan.api import limits

SPECS = Path(__file__).parents[2] / "specs"
WIDTH = "scene.insert.width_mm"
SCENE = (str(SPECS / "bookshelf_scene.yaml"), "--of", WIDTH)


def test_the_widest_book(run_command: RunCommand, workplace: Path) -> None:
    outcome = run_command("limits", *SCENE, "--tolerance", "10")
    assert outcome.code == 0, outcome.err
    key, _, value = outcome.out.strip().partition("=")
    assert key == WIDTH
    lines = outcome.err.splitlines()
    assert lines[0].split() == ["bookshelf_scene", "largest", WIDTH, "[mm],", "from", "17", "mm"]
    assert lines[1].startswith("try       17 mm")
    assert any(line.startswith("limit ") and "ends it: proved infeasible" in line for line in lines)
    folder = workplace / "outputs" / "bookshelf_scene_limits"
    made = {path.name for path in folder.iterdir()}
    assert made == {
        "plan.h5", "report.json", "report.html", "figures", "limits.csv", "limits.json",
    }  # fmt: skip
    table = (folder / "limits.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(table.splitlines()))
    passed = [float(row["value_mm"]) for row in rows if row["outcome"] == "verified"]
    assert max(passed) == float(value)
    assert json.loads((folder / "limits.json").read_text())["value"] == float(value)
    assert run_command("verify", str(folder)).code == 0
    # The plan is that of the plan command, at the value that was printed
    again = run_command(
        "solve-bookshelf", SCENE[0], "--set", outcome.out.strip(), "--no-report", "-o", "again"
    )
    assert again.code == 0
    first, second = (
        json.loads((place / "report.json").read_text()) for place in (folder, workplace / "again")
    )
    assert (first["objective"], first["spec_sha256"]) == (
        second["objective"], second["spec_sha256"],
    )  # fmt: skip
    assert run_command("limits", *SCENE).code == 2  # exists


def test_json_and_a_time_limit(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("limits", *SCENE, "--to", "34", "--no-report", "--json", "-q", "-o", "out")
    assert done.err == ""
    answer = json.loads(done.out)
    assert (answer["of"], answer["unit"], answer["value"]) == (WIDTH, "mm", 34)
    assert (answer["ended_by"], answer["exit_code"], answer["plan"]) == ("range", 0, "out/plan.h5")
    assert [trial["value"] for trial in answer["trials"]] == [17, 34]
    late = run_command("limits", *SCENE, "--time-limit", "1e-6", "--json", "-o", "late")
    failure = json.loads(late.out)
    assert (late.code, failure["status"], failure["exit_code"]) == (4, "limit", 4)
    assert failure["value"] is None
    assert not (workplace / "late").exists()


def test_no_value_counts(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("limits", *SCENE, "--from", "120", "--json", "-o", "out")
    answer = json.loads(done.out)
    assert (done.code, answer["status"], answer["ended_by"]) == (4, "not_proved", "nothing")
    assert answer["remedies"]
    assert [trial["outcome"] for trial in answer["trials"]] == ["infeasible"]
    assert not (workplace / "out").exists()


def test_the_best_plan_survives_an_interrupt(
    run_command: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = limits.plan_and_verify
    calls: list[object] = []

    def stop_at_third(loaded: object, options: Any) -> Any:
        calls.append(loaded)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return plan(loaded, options)

    monkeypatch.setattr(limits, "plan_and_verify", stop_at_third)
    done = run_command("limits", *SCENE, "--json", "-o", "out")
    assert done.code == 130
    answer = json.loads(done.out)
    assert (answer["status"], answer["value"], answer["plan"]) == ("interrupted", 34, "out/plan.h5")
    assert answer["ended_by"] == "interrupt"
    folder = workplace / "out"
    assert {"plan.h5", "limits.csv", "limits.json"} <= {path.name for path in folder.iterdir()}
    assert json.loads((folder / "limits.json").read_text())["value"] == 34
    assert [path.name for path in workplace.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--of", "scene.insert.wdth_mm"), "did you mean 'width_mm'"),
        (("--of", "title"), "a key whose value is a number"),
        (("--of", WIDTH, "--from", "30", "--to", "20"), "below the upper one, got 30 and 20"),
        (("--of", WIDTH, "--from", "-3"), "--set scene.insert.width_mm=-3.0"),
        (("--of", WIDTH, "--tolerance", "wide"), "tolerance: expected"),
        (("--of", "solver.gap"), "largest or its smallest"),
        ((), "--of"),
    ],
)
def test_bad_input(
    run_command: RunCommand, workplace: Path, options: tuple[str, ...], message: str
) -> None:
    done = run_command("limits", SCENE[0], *options)
    assert done.code == 2
    assert message in done.err
    assert not (workplace / "outputs").exists()
