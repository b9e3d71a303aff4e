"""`--json`: one object on standard output however a run ends, with the exit code in it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import h5py
import pytest
from command_line import Outcome, RunCommand

FIELDS = {"status", "stage", "message", "conflict", "remedies", "exit_code"}
SHORT = (
    "--set", "task.rounds=1", "--set", "task.goal.com=[0,0,0.04]", "--set", "task.goal.toes={}",
    "--set", "study=null", "--no-report",
)  # fmt: skip


def answer(outcome: Outcome) -> dict[str, Any]:
    """The one object that was printed; its exit code is the run's."""
    found: dict[str, Any] = json.loads(outcome.out)
    assert found["exit_code"] == outcome.code
    return found


def test_success_names_the_plan(run_command: RunCommand) -> None:
    told = answer(run_command("plan-climb", "small.yaml", *SHORT, "--json"))
    assert told["plan"] == "outputs/small/plan.h5"
    assert told["exit_code"] == 0
    assert told["verified"] is True
    assert "message" not in told
    verified = answer(run_command("verify", "outputs/small", "--json"))
    assert verified["exit_code"] == 0


def test_refusal_carries_conflicts_and_remedies(run_command: RunCommand) -> None:
    slippery = ("--set", "terrain.friction=0.05", "--set", "terrain.regions=[]", *SHORT)
    outcome = run_command("plan-climb", "small.yaml", *slippery, "--json")
    told = answer(outcome)
    assert told.keys() >= FIELDS
    assert told["status"] == ("infeasible" if outcome.code == 3 else "not_proved")
    assert told["stage"]
    assert told["message"] in outcome.err
    keys = {remedy["key"] for remedy in told["remedies"]}
    assert "terrain.friction" in keys
    cure = next(r for r in told["remedies"] if r["key"] == "terrain.friction")
    assert cure["value"] > 0.05
    assert cure["words"]
    first = told["conflict"][0]
    assert first.keys() == {"where", "constraints", "names", "remedies"}
    assert first["constraints"]
    # The same words for people as ever
    assert outcome.err.startswith("error: ")


def test_mistakes_of_a_spec_are_listed(run_command: RunCommand) -> None:
    outcome = run_command("plan-climb", "small.yaml", "--set", "terrain.frction=1", "--json")
    told = answer(outcome)
    assert (told["status"], told["stage"], told["exit_code"]) == ("usage", "spec", 2)
    (mistake,) = told["mistakes"]
    assert mistake["key"] == "terrain.frction"
    assert mistake["suggestion"] == "friction"
    assert mistake["source"] == "--set terrain.frction=1"
    assert "frction" in outcome.err


@pytest.mark.parametrize(
    "line",
    [
        ("plan-climb", "small.yaml", "--bla", "--json"),
        ("plan-climb", "--json"),
        ("plan-climb", "small.yaml", "--jobs", "none", "--json"),
        ("no-such-command", "--json"),
        ("--json",),
        ("export", "small.yaml", "--json"),
    ],
)
def test_a_command_line_that_is_wrong(run_command: RunCommand, line: tuple[str, ...]) -> None:
    outcome = run_command(*line)
    told = answer(outcome)
    assert (told["status"], told["stage"], told["exit_code"]) == ("usage", "arguments", 2)
    assert told["message"].rstrip(".") in outcome.err


def test_paths_that_are_wrong(run_command: RunCommand) -> None:
    told = answer(run_command("verify", "no\x9b2Jwhere.h5", "--json"))
    assert told["status"] == "usage"
    assert told["message"].startswith("no\x9b2Jwhere.h5")  # whole, and escaped on the way


def test_a_plan_that_fails_is_told_with_what_it_is(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    import climbplan.climb.plan.file as climb_file

    whole = climb_file.write_climb

    def spoilt(plan: Any, path: Path) -> None:
        whole(plan, path)
        with h5py.File(path, "r+") as file:
            file["instants/force"][:] *= 1.1

    monkeypatch.setattr(climb_file, "write_climb", spoilt)
    told = answer(run_command("plan-climb", "small.yaml", *SHORT, "--json"))
    assert told["exit_code"] == 5
    assert told["verified"] is False
    assert told["plan"] == "outputs/small/plan.h5"
    assert told["message"].startswith("outputs/small/plan.h5 fails its verification")
    assert told["stage"] == "verify"
    again = answer(run_command("verify", "outputs/small", "--json"))
    assert (again["exit_code"], again["status"]) == (5, "unverified")


def test_interrupted(run_command: RunCommand, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(loaded: object, report: Any, **options: object) -> NoReturn:
        report("posture", 0.5)
        raise KeyboardInterrupt

    monkeypatch.setattr("climbplan.climb.planner.planner.plan_climb", stopped)
    outcome = run_command("plan-climb", "small.yaml", "--json")
    told = answer(outcome)
    assert (told["status"], told["exit_code"]) == ("interrupted", 130)
    assert told["stage"] == "posture"
    assert outcome.err == "interrupted\n"


def test_terminated(tmp_path: Path) -> None:
    spec = Path(__file__).parents[2] / "specs" / "climb_region.yaml"
    line = [sys.executable, "-m", "climbplan", "plan-climb", str(spec), "-o", "plan", "--json"]
    run = subprocess.Popen(line, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    begun = time.monotonic()
    while not list(tmp_path.iterdir()) and time.monotonic() - begun < 60:
        time.sleep(0.02)
    run.send_signal(signal.SIGTERM)
    printed, _ = run.communicate(timeout=60)
    told = json.loads(printed)
    assert (told["status"], told["exit_code"], run.returncode) == ("interrupted", 143, 143)


def test_a_bug(run_command: RunCommand, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*given: object, **options: object) -> NoReturn:
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr("climbplan.climb.planner.planner.plan_climb", broken)
    told = answer(run_command("plan-climb", "small.yaml", "--json"))
    assert (told["status"], told["exit_code"]) == ("error", 1)
    assert told["message"] == "ZeroDivisionError: by chance"


def test_help_and_schema_are_as_without(run_command: RunCommand) -> None:
    helped = run_command("plan-climb", "--json", "--help")
    assert helped.code == 0
    assert helped.out.startswith("Usage:")
    schema = run_command("schema", "climb")
    assert "exit_code" not in json.loads(schema.out)


def test_validate_lists_specs_and_says_how_it_ended(run_command: RunCommand) -> None:
    told = answer(run_command("validate", "small.yaml", "none.yaml", "--json"))
    assert told["exit_code"] == 2
    assert [spec["valid"] for spec in told["specs"]] == [True, False]


def test_killed_by_who_watches_over_it(tmp_path: Path) -> None:
    """A process that is deaf to signals is killed; its answer is printed by the one above it."""
    code = (
        "import signal, sys, time\n"
        "from climbplan.cli import app\n"
        "def deaf():\n"
        "    for each in (signal.SIGINT, signal.SIGTERM):\n"
        "        signal.signal(each, signal.SIG_IGN)\n"
        "    print('deaf', file=sys.stderr, flush=True)\n"
        "    time.sleep(60)\n"
        "app.run = deaf\n"
        "sys.argv = ['climbplan', 'plan-climb', 'x.yaml', '--json']\n"
        "app.main()\n"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stderr is not None
    assert run.stderr.readline() == "deaf\n"
    run.send_signal(signal.SIGTERM)
    printed, said = run.communicate(timeout=30)
    told = json.loads(printed)
    assert (told["status"], told["exit_code"], run.returncode) == ("interrupted", 143, 143)
    assert told.keys() >= FIELDS
    assert said == "terminated\n"
