"""`python -m benchmarks` as its users type it, run in this process."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
import typer
from command_line import Outcome, RunCommand

from benchmarks.app import app
from benchmarks.climb import courses
from benchmarks.engine import run as engine
from benchmarks.record import split_tables
from climbplan.instances import families

NAMES = {
    "posture", "force", "plan", "coupled", "transition", "mpc", "refusals", "stands", "scans",
    "judge", "zoo", "growth", "windows", "bookshelf", "strategies", "limms", "instances", "engine",
    "courses", "conic", "qplib", "closed_loop", "learned", "motions", "startup",
}  # fmt: skip
SHARED = {"--quick", "--json", "--quiet", "--verbose"}


@pytest.fixture
def run_benchmark(workplace: Path, capsys: pytest.CaptureFixture[str]) -> RunCommand:
    """Run a command line of the benchmarks in an empty folder."""

    def command(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as end:
            app(list(arguments), prog_name="benchmarks")
        captured = capsys.readouterr()
        return Outcome(int(end.value.code or 0), captured.out, captured.err)

    return command


def read_table(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_list_has_every_benchmark_with_its_meaning(run_benchmark: RunCommand) -> None:
    listed = [line.split(maxsplit=1) for line in run_benchmark("--list").out.splitlines()]
    assert {name for name, _ in listed} == NAMES
    assert all(len(meaning.split()) > 4 and meaning.endswith(".") for _, meaning in listed)


def test_each_benchmark_has_its_own_options_and_the_shared_ones() -> None:
    commands = typer.main.get_group(app).commands
    options = {
        name: {option for parameter in command.params for option in parameter.opts}
        for name, command in commands.items()
    }
    assert all(found >= SHARED for found in options.values())
    assert {name for name, found in options.items() if "--seed" not in found} == {
        "motions",
        "qplib",
        "scans",
        "startup",
    }
    assert {name for name, found in options.items() if "--force" in found} == {
        "bookshelf",
        "strategies",
        "limms",
        "mpc",
    }
    assert options["growth"] == SHARED | {"--seed", "-q", "-v"}
    assert options["refusals"] - options["growth"] == {"--count", "--time-limit"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("frob",), "No such command 'frob'"),
        (("plan", "--count", "3"), "No such option: --count"),
        (("engine", "--out", "tables"), "No such option: --out"),
        (("limms", "--few", "3"), "No such option: --few"),
        (("limms", "--methods", "modes,exact", "--count", "0"), "expected some of modes, admm"),
        (("instances", "--methods", "cplex"), "no 'cplex', known are"),
        (("instances", "--count", "0"), "--count"),
        (("startup", "--quick", "--python", "nowhere/python"), "nowhere/python"),
        (("motions",), "expected some of --dataset DIR"),
        (("motions", "--scenes", "climb_nowhere"), "no scene 'climb_nowhere'"),
        (("closed_loop", "--scenes", "climb_nowhere"), "'climb_nowhere' is unknown"),
        (("closed_loop", "--kinds", "3 kg more"), "known are drawn, 20 mm nearer"),
        (("growth", "--json", "none/growth.json"), "none/growth.json: no such directory"),
        (("scans", "--scenes", "."), "give the folder with the meshes of hpp-environments by"),
    ],
)
def test_mistakes_are_named(
    run_benchmark: RunCommand, arguments: tuple[str, ...], words: str
) -> None:
    outcome = run_benchmark(*arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert words in outcome.err


def test_engine_draws_by_its_seed_and_records_its_table(
    run_benchmark: RunCommand, monkeypatch: pytest.MonkeyPatch, workplace: Path
) -> None:
    runs: list[tuple[int, bool]] = []

    def measure(seed: int, quick: bool, stream: io.StringIO) -> None:
        runs.append((seed, quick))
        print("times\n            ms   ratio\ntree       1.5     1.0", file=stream)

    monkeypatch.setattr(engine, "run_engine", measure)
    outcome = run_benchmark("engine", "--seed", "5", "--quick", "--json", "engine.json")
    assert outcome.code == 0
    assert outcome.out.splitlines()[-1] == "tree       1.5     1.0"
    assert outcome.err.startswith("engine: The own trees")
    record = json.loads((workplace / "engine.json").read_text())
    assert record["benchmark"] == "engine"
    assert record["options"] == {"quick": True, "seed": 5}
    assert record["machine"]["cpu_count"] > 0
    assert {"python", "numpy", "casadi", "highspy"} <= set(record["versions"])
    assert set(record) >= {"date", "commit"}
    (table,) = record["results"]["tables"]
    assert table == {
        "title": "times",
        "header": ["", "ms", "ratio"],
        "rows": [["tree", "1.5", "1.0"]],
    }
    assert run_benchmark("engine", "--quiet").err == ""
    assert runs == [(5, True), (0, False)]


def test_bookshelf_writes_figures_text_and_plots(
    run_benchmark: RunCommand, workplace: Path
) -> None:
    arguments = ("bookshelf", "--methods", "exact", "--count", "2", "--out", "shelf")
    outcome = run_benchmark(*arguments, "--json", "shelf.json")
    assert outcome.code == 0, outcome.err
    assert (workplace / "shelf" / "bench.txt").read_text() == outcome.out
    record = json.loads((workplace / "shelf" / "bench.json").read_text())
    assert record == json.loads((workplace / "shelf.json").read_text())
    assert record["options"]["count"] == 2
    (row,) = record["results"]["methods"]
    assert (row["method"], row["success"]) == ("exact", 1.0)
    for name in ("success", "cost", "time"):
        assert (workplace / "shelf" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    again = run_benchmark(*arguments)
    assert again.code == 2
    assert "--force replaces it" in again.err


def test_instances_continue_where_they_were_ended(
    run_benchmark: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = tuple(f for f in families.FAMILIES if f.name in ("cart-poles", "free-flyers"))
    monkeypatch.setattr(families, "FAMILIES", few)
    arguments = ("instances", "--count", "1", "--time-limit", "0.3", "--out", "results")
    first = run_benchmark(*arguments, "--methods", "tree")
    assert first.code == 0, first.err
    assert first.out.startswith("limit 0.3 s")
    assert "scip " not in first.out.split("of scip", 1)[1]
    rows = read_table(workplace / "results" / "results.csv")
    assert [row["contender"] for row in rows] == 6 * ["tree"]
    assert run_benchmark(*arguments, "--methods", "highs,tree").code == 0
    more = read_table(workplace / "results" / "results.csv")
    assert more[:6] == rows  # nothing is solved twice
    assert {row["contender"] for row in more[6:]} == {"highs"}
    known = read_table(workplace / "results" / "known.csv")
    assert {row["name"] for row in known} == {row["name"] for row in rows}


def test_titles_and_notes_stay_beside_their_tables() -> None:
    text = "two goals\nname      ms  ratio\nours     1.0    1.0\n\nnote\nlast  x\nend of it\n"
    first, second, note = split_tables(text)
    assert first["title"] == "two goals"
    assert first["rows"] == [["ours", "1.0", "1.0"]]
    assert (second["title"], second["header"]) == ("note", ["last", "x"])
    assert (note["title"], note["rows"]) == ("end of it", [])


def test_courses_continue_where_they_were_ended(
    run_benchmark: RunCommand, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walker = courses.Walker("silvia", "silvia", 0.24, 0.1, "stance: {}")
    planned: list[int] = []

    def plan(walker: courses.Walker, kind: str, seed: int, folder: Path) -> courses.CourseRow:
        planned.append(seed)
        outcome = "falls at 3.1 s" if seed else "2 slips, 0 lost"
        return courses.CourseRow(walker.name, kind, seed, outcome, True, 3, 1.5)

    monkeypatch.setattr(courses, "propose_walkers", lambda folder: [walker])
    monkeypatch.setattr(courses, "_plan_course", plan)
    arguments = ("courses", "--scenes", "stones", "--out", "kept")
    assert run_benchmark(*arguments, "--count", "1").code == 0
    outcome = run_benchmark(*arguments, "--count", "2")
    assert outcome.code == 0, outcome.err
    assert planned == [0, 1]  # nothing is planned twice
    line = " ".join(outcome.out.splitlines()[1].split())
    assert line == "silvia stones 2 of 2 1 of 2 0 of 2 1.5 1.5"
    (workplace / "kept" / "courses.csv").write_text("robot,is_verified\nsilvia,perhaps\n")
    assert "no rows of CourseRow" in run_benchmark(*arguments, "--count", "1").err
