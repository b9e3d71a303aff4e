"""`climbplan gen-data` and `climbplan data`: streams, exit codes, resuming, libraries."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import RunCommand

from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import read_dataset_file, write_dataset_file

pytest.importorskip("pymunk")

ROOT = Path(__file__).parents[2]
SPEC = """
kind: dataset
count: 12
seed: 4
shard_size: 5
problem: {kind: bookshelf, books: 2}
"""
CART_POLE = f"{ROOT / 'specs' / 'cart_pole.py'}:springs"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished dataset, and its working directory as a stopped run leaves it."""
    from climbplan.cli.app import run

    place = tmp_path_factory.mktemp("finished")
    (place / "small_data.yaml").write_text(SPEC)
    keep = place / "kept"

    from climbplan.datasets import workspace

    original = workspace.RunDirectory.remove

    def copied(self: workspace.RunDirectory) -> None:
        shutil.copytree(self.path, keep)
        original(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace.RunDirectory, "remove", copied)
        assert run(["gen-data", str(place / "small_data.yaml"), "--out", str(place / "out")]) == 0
    return place


@pytest.fixture
def dataset(finished: Path, workplace: Path) -> Path:
    """The finished dataset and its spec in the working directory."""
    shutil.copytree(finished / "out", workplace / "out")
    shutil.copy(finished / "small_data.yaml", workplace / "small_data.yaml")
    return workplace / "out" / "dataset.h5"


@pytest.fixture
def stopped(finished: Path, workplace: Path) -> Path:
    """What a run leaves that is killed before its last shard."""
    shutil.copy(finished / "small_data.yaml", workplace / "small_data.yaml")
    rows = workplace / ".out.rows"
    shutil.copytree(finished / "kept", rows)
    (rows / "rows_00000010_00000011.shard").unlink()
    return rows


def assert_same_rows(found: Dataset, wanted: Dataset) -> None:
    np.testing.assert_array_equal(found.parameters, wanted.parameters)
    np.testing.assert_array_equal(found.integers, wanted.integers)
    np.testing.assert_array_equal(found.objective, wanted.objective)
    np.testing.assert_array_equal(found.solution["pose"], wanted.solution["pose"])
    assert found.status == wanted.status


def test_finished_directory(dataset: Path) -> None:
    made = {p.name for p in dataset.parent.iterdir()}
    assert made == {"dataset.h5", "report.json", "report.html", "figures"}
    found = read_dataset_file(dataset)
    assert found.verified
    assert found.count == 12
    assert found.feasible.all()
    report = json.loads((dataset.parent / "report.json").read_text())
    assert report["format"] == "climbplan/dataset"
    assert report["rows"]["answered"] == 12
    assert all(check["passed"] for check in report["verification"])
    names = {p.stem for p in (dataset.parent / "figures").iterdir()}
    assert names == {"statistics", "states", "gallery_1"}
    page = (dataset.parent / "report.html").read_text()
    assert "12 of 12" in page
    assert page.count("data:image/png") == 3


def test_verify_report_and_export_know_datasets(dataset: Path, run_command: RunCommand) -> None:
    assert run_command("verify", "out").code == 0
    shown = run_command("report", "out", "--json")
    assert json.loads(shown.out)["rows"]["count"] == 12
    assert run_command("export", "out").out == "out/dataset.csv\n"
    with (dataset.parent / "dataset.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 12


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("solution/pose", "book."),
        ("objective", "file.objective"),
        ("integers", "rows.integers"),
        ("solution/slot", "solution.slot"),
    ],
)
def test_verify_notices_what_was_changed(
    dataset: Path, run_command: RunCommand, name: str, check: str
) -> None:
    with h5py.File(dataset, "r+") as file:
        values = file[name][()]
        values.reshape(-1)[:4] += 1
        file[name][...] = values
    outcome = run_command("verify", "out")
    assert outcome.code == 5
    assert any(check in line and "FAILED" in line for line in outcome.out.splitlines())


def test_hostile_file_is_bad_usage(dataset: Path, run_command: RunCommand) -> None:
    with h5py.File(dataset, "r+") as file:
        del file["solution/pose"]
        file["solution/pose"] = np.zeros((12, 3))
    for arguments in (["verify", "out"], ["data", "info", "out"], ["data", "split", "out"]):
        outcome = run_command(*arguments)
        assert outcome.code == 2
        assert "solution/pose has shape (12, 3)" in outcome.err
    dataset.write_bytes(dataset.read_bytes()[:3000])
    assert run_command("data", "info", "out").code == 2


def test_reasons_of_a_hostile_file_do_not_drive_the_terminal(
    dataset: Path, run_command: RunCommand
) -> None:
    data = read_dataset_file(dataset)
    message = ("\x1b]0;owned\x07\x9b2J", *data.message[1:])
    status = ("failed", *data.status[1:])
    feasible = np.append(False, data.feasible[1:])
    write_dataset_file(replace(data, message=message, status=status, feasible=feasible), dataset)
    outcome = run_command("data", "info", "out")
    assert outcome.code == 0
    assert r"\x1b]0;owned\x07\x9b2J" in outcome.out
    assert not set(outcome.out) & {"\x1b", "\x07", "\x9b"}


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("solution/state", 99, "states [99, 99, 99] and slot"),
        ("solution/slot", -7, "slot -7 of its placement"),
        ("solution/pose", 1e300, "solution/pose holds numbers beyond 1e+30"),
        ("objective", -1e308, "objective holds numbers beyond 1e+30"),
        ("parameters", 1e-320, "expected at least 1e-06"),
        ("facts", "9" * 400, "facts: a number of 401 digits is out of range"),
        ("facts", "1e999", "facts: the number -1e999 is out of range"),
        ("facts", "1e300", "facts: the number -1e300 is out of range"),
        ("facts", "1e50", "shelf: expected numbers up to 100 m"),
    ],
)
def test_a_hostile_dataset_is_no_library(
    dataset: Path, run_command: RunCommand, name: str, value: object, words: str
) -> None:
    with h5py.File(dataset, "r+") as file:
        if name == "facts":
            assert "0.05911" in file.attrs["facts"]
            file.attrs["facts"] = file.attrs["facts"].replace("0.05911", str(value))
        else:
            file[name][...] = value
    outcome = run_command(
        "fit-strategy", str(ROOT / "specs" / "strategy_bookshelf.yaml"),
        "--set", "data.files=[out/dataset.h5]",
    )  # fmt: skip
    assert outcome.code == 2
    assert words in outcome.err
    if name == "solution/state":
        assert run_command("report", "out", "--force").code == 0
        assert run_command("verify", "out").code == 5


def test_a_finished_dataset_is_not_overwritten(dataset: Path, run_command: RunCommand) -> None:
    outcome = run_command("gen-data", "small_data.yaml", "--out", "out")
    assert outcome.code == 2
    assert "--force" in outcome.err
    again = run_command("gen-data", "small_data.yaml", "--out", "out", "--resume")
    assert (again.code, again.out) == (0, "out/dataset.h5\n")
    assert "complete already" in again.err


def test_resume_makes_what_is_missing(
    finished: Path, stopped: Path, run_command: RunCommand
) -> None:
    damaged = stopped / "rows_00000000_00000004.shard"
    damaged.write_bytes(damaged.read_bytes()[:-9])
    outcome = run_command("gen-data", "small_data.yaml", "--out", "out", "--resume", "--jobs", "2")
    assert outcome.code == 0, outcome.err
    assert "rows_00000000_00000004.shard (rows 0 to 4): damaged" in outcome.err
    assert "going on: 5 of 12 rows" in outcome.err
    found = read_dataset_file(Path("out", "dataset.h5"))
    assert_same_rows(found, read_dataset_file(finished / "out" / "dataset.h5"))
    assert not stopped.exists()


def test_a_stopped_run_is_not_thrown_away(stopped: Path, run_command: RunCommand) -> None:
    outcome = run_command("gen-data", "small_data.yaml", "--out", "out")
    assert outcome.code == 2
    assert "a stopped run is there; --resume goes on with it, --force starts anew" in outcome.err
    assert len(list(stopped.glob("*.shard"))) == 2
    assert not Path("out").exists()


def test_resume_refuses_another_spec(stopped: Path, run_command: RunCommand) -> None:
    outcome = run_command(
        "gen-data", "small_data.yaml", "--out", "out", "--resume",
        "--set", "problem.books=3", "--set", "count=13",
    )  # fmt: skip
    assert outcome.code == 2
    assert "count: 12 in the stopped run, 13 now" in outcome.err
    assert "problem.books: 2 in the stopped run, 3 now" in outcome.err
    assert len(list(stopped.glob("*.shard"))) == 2


def test_split_and_merge(dataset: Path, run_command: RunCommand) -> None:
    assert run_command("data", "split", "out", "--test", "0.25").code == 0
    masks = read_dataset_file(dataset)
    assert masks.train is not None
    assert masks.test is not None
    assert (masks.train.sum(), masks.test.sum()) == (9, 3)
    assert "9 train, 3 test" in run_command("data", "info", "out").out
    outcome = run_command("data", "split", "out", "--files", "parts")
    assert outcome.out == "parts/train.h5\nparts/test.h5\n"
    files = ["parts/train.h5", "parts/test.h5"]
    assert run_command("data", "merge", *files, "--out", "whole.h5").out == "whole.h5\n"
    assert set(read_dataset_file(Path("whole.h5")).hashes()) == set(masks.hashes())
    assert run_command("verify", "whole.h5").code == 0
    again = run_command("data", "merge", "out", "whole.h5", "--out", "twice.h5")
    assert again.code == 2
    assert "12 rows hold a problem that an earlier row holds" in again.err
    dropped = run_command("data", "merge", "out", "whole.h5", "-o", "x.h5", "--drop-duplicates")
    assert dropped.code == 0
    assert "12 rows left out" in dropped.err


def test_info_as_json(dataset: Path, run_command: RunCommand) -> None:
    (figures,) = json.loads(run_command("data", "info", "out", "--json").out)["datasets"]
    assert figures["rows"]["optimal"] == 12


def test_export_says_what_it_can_write(dataset: Path, run_command: RunCommand) -> None:
    outcome = run_command("data", "export", "out", "--out", "table.xlsx")
    assert outcome.code == 2
    assert ".csv or .parquet" in outcome.err
    assert run_command("data", "export", "out", "-o", "-").out.startswith("row,seed,")


def test_a_dataset_is_a_library_of_the_bookshelf(dataset: Path, run_command: RunCommand) -> None:
    Path("scene.yaml").write_text(
        "kind: bookshelf\n"
        "shelf: {left_mm: -59.11, right_mm: 59.11}\n"
        "scene:\n"
        "  books: [{x_mm: -40, height_mm: 60, width_mm: 20}, {x_mm: 10, height_mm: 60, "
        "width_mm: 20}]\n"
        "  insert: {height_mm: 70, width_mm: 20}\n"
        "solver: {method: knn, library: {file: out/dataset.h5}}\n"
    )
    outcome = run_command("solve-bookshelf", "scene.yaml", "--out", "placed")
    assert outcome.code == 0, outcome.err
    other = ("--set", "shelf.right_mm=60", "--out", "other")
    outcome = run_command("solve-bookshelf", "scene.yaml", *other)
    assert outcome.code == 2
    assert "made for a shelf whose right is 0.05911 m, here it is 0.06 m" in outcome.err
    taken = run_command(
        "solve-bookshelf", "scene.yaml", *other, "-s", "solver.library.allow_other_shelves=true"
    )
    assert taken.code == 0, taken.err
    data = read_dataset_file(dataset)
    write_dataset_file(replace(data, frame=replace(data.frame, kind="toy")), dataset)
    outcome = run_command("solve-bookshelf", "scene.yaml", "--out", "again")
    assert outcome.code == 2
    assert "expected 'bookshelf'" in outcome.err


def test_code_is_named_on_the_command_line_only(workplace: Path, run_command: RunCommand) -> None:
    (workplace / "own.yaml").write_text(
        "kind: dataset\ncount: 3\nproblem:\n  kind: program\n  solver: {method: mpcc}\n"
    )
    outcome = run_command("gen-data", "own.yaml")
    assert outcome.code == 2
    assert "--problem MODULE:OBJECT" in outcome.err
    assert not Path("outputs").exists()


def test_a_problem_of_ones_own(workplace: Path, run_command: RunCommand) -> None:
    (workplace / "own.yaml").write_text(
        "kind: dataset\ncount: 3\nproblem:\n  kind: program\n"
        "  solver: {method: minlp-scip, gap: 0.1}\n"
    )
    outcome = run_command("gen-data", "own.yaml", "--problem", CART_POLE, "--out", "own")
    assert outcome.code == 0, outcome.err
    assert read_dataset_file(Path("own", "dataset.h5")).feasible.all()
    assert run_command("verify", "own", "--problem", CART_POLE).code == 0
    alone = run_command("verify", "own")
    assert alone.code == 2
    assert "add --problem" in alone.err


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("problem.kind=bookshelv", "expected one of `bookshelf`, `program`"),
        ("problem.books=0", "problem.books"),
        ("problem.drop.width_mm=[40, 10]", "expected 0 < least <= largest"),
        ("problem.solver.method=exakt", "did you mean 'exact'"),
        ("count=0", "count"),
        ("problem.formulation=published", "`exact` solves the formulation `contact` only"),
    ],
)
def test_bad_specs(workplace: Path, run_command: RunCommand, setting: str, words: str) -> None:
    (workplace / "small_data.yaml").write_text(SPEC)
    outcome = run_command("gen-data", "small_data.yaml", "--set", setting)
    assert outcome.code == 2
    assert words in outcome.err


def test_bad_schedulers(workplace: Path, run_command: RunCommand) -> None:
    pytest.importorskip("distributed")
    (workplace / "small_data.yaml").write_text(SPEC)
    for name, words in (("cluster", "tcp://HOST:PORT"), ("local-cluster:0", "at least one")):
        outcome = run_command("gen-data", "small_data.yaml", "--scheduler", name)
        assert outcome.code == 2
        assert words in outcome.err


def test_without_dask_it_says_how_to_get_it(
    workplace: Path, run_command: RunCommand, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    (workplace / "small_data.yaml").write_text(SPEC)
    outcome = run_command("gen-data", "small_data.yaml", "--scheduler", "tcp://localhost:1")
    assert outcome.code == 2
    assert "climbplan[cluster]" in outcome.err
    assert not list(workplace.glob(".*.rows"))
