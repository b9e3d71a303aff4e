"""`export --instances`, `bench instances` and `bench engine` as their users type them."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from command_line import RunCommand

from climbplan.bench.engine import run as engine
from climbplan.bench.instances import families

_SMALL = ("cart-poles", "free-flyers")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two families that are drawn in no time."""
    kept = tuple(f for f in families.FAMILIES if f.name in _SMALL)
    monkeypatch.setattr(families, "FAMILIES", kept)


def _table(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


@pytest.mark.usefixtures("few")
def test_export_writes_the_set_and_its_path(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("export", "--instances", "set", "--count", "1")
    assert (done.code, done.out) == (0, "set\n")
    assert "6 instances, seed 0" in done.err
    rows = _table(workplace / "set" / "instances.csv")
    assert len(rows) == 6
    assert all((workplace / "set" / row["file"]).stat().st_size > 0 for row in rows)
    assert (workplace / "set" / "check_solution.py").exists()
    again = run_command("export", "--instances", "set", "--count", "1")
    assert again.code == 2
    assert "--force" in again.err
    first = (workplace / "set" / rows[0]["file"]).read_text()
    other = run_command("export", "--instances", "set", "--count", "1", "--seed", "7", "--force")
    assert other.code == 0
    changed = workplace / "set" / rows[0]["file"]
    assert changed.read_text() != first
    # Best values are known of seed 0 alone, and are claimed of no other
    assert not any(row["best_known"] for row in _table(workplace / "set" / "instances.csv"))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--instances", "set", "--rate", "100"), "--instances DIR: no plan"),
        (("plan.h5", "--instances", "set"), "--instances DIR: no plan"),
        (("plan.h5", "--count", "2"), "--seed and --count go with --instances"),
        (("--seed", "2"), "a PLAN is missing"),
        (("--instances", "set", "--count", "0"), "--count"),
    ],
)
def test_export_refuses_what_does_not_go_together(
    run_command: RunCommand, workplace: Path, options: tuple[str, ...], word: str
) -> None:
    outcome = run_command("export", *options)
    assert outcome.code == 2
    assert outcome.out == ""
    assert word in outcome.err
    assert not (workplace / "set").exists()


@pytest.mark.usefixtures("few")
def test_bench_instances_goes_on_where_it_was_ended(
    run_command: RunCommand, workplace: Path
) -> None:
    asked = ("bench", "instances", "--count", "1", "--time-limit", "0.3", "--out", "results")
    one = run_command(*asked, "--methods", "tree")
    assert one.code == 0, one.err
    assert one.out.startswith("limit 0.3 s")
    assert "scip " not in one.out.split("of scip", 1)[1]
    rows = _table(workplace / "results" / "results.csv")
    assert [row["contender"] for row in rows] == 6 * ["tree"]
    both = run_command(*asked, "--methods", "highs,tree")
    assert both.code == 0
    more = _table(workplace / "results" / "results.csv")
    assert more[:6] == rows  # nothing is solved twice
    assert {row["contender"] for row in more[6:]} == {"highs"}
    assert {row["name"] for row in _table(workplace / "results" / "known.csv")} == {
        row["name"] for row in rows
    }


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("instances", "--methods", "cplex"), "no 'cplex', known are"),
        (("instances", "--json"), "results.csv of --out has all numbers"),
        (("instances", "--count", "0"), "--count"),
        (("instances", "--few", "2"), "has no --few"),
        (("engine", "--count", "2"), "options from --scenes to --json"),
        (("engine", "--out", "tables"), "options from --scenes to --json"),
    ],
)
def test_bench_refuses_what_it_does_not_know(
    run_command: RunCommand, options: tuple[str, ...], word: str
) -> None:
    outcome = run_command("bench", *options)
    assert outcome.code == 2
    assert (outcome.out == "") == ("--json" not in options)  # which has an object for failures
    assert word in outcome.err


def test_bench_engine_draws_by_its_seed(
    run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, bool]] = []

    def told(seed: int, quick: bool, stream: object) -> None:
        asked.append((seed, quick))
        print("a table", file=stream)  # type: ignore[call-overload]

    monkeypatch.setattr(engine, "run_engine", told)
    outcome = run_command("bench", "engine", "--seed", "5", "--quick")
    assert (outcome.code, outcome.out) == (0, "a table\n")
    assert asked == [(5, True)]
    assert run_command("bench", "engine").code == 0
    assert asked[1][1] is False
