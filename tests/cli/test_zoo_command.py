"""`zoo`: rows are kept robot by robot, and a later run goes on with them."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from benchmarks.kept_rows import read_rows, write_rows
from benchmarks.zoo.cells import COLUMNS
from benchmarks.zoo.results import FILE, Row
from benchmarks.zoo.robots import PACKAGE, ROBOTS
from benchmarks.zoo.run import bench_zoo
from climbplan.errors import UsageError
from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf


@pytest.fixture(name="package")
def _package() -> None:
    try:
        find_package_urdf(f"{PACKAGE}:robots/solo12")
    except UsageError:
        pytest.skip(f"{PACKAGE} is not installed")


def row(robot: str, column: str, **other: object) -> Row:
    values = {"mass": 2.5, "legs": 4, "proposed": 1.0, "planned": True, "simulated": "stands"}
    values |= {"words": "keeps 90% of its margins", "cpu": 2.0, **other}
    return Row(robot=robot, column=column, **values)  # type: ignore[arg-type]


def test_what_is_kept_is_not_made_again(tmp_path: Path) -> None:
    """A table from rows alone: nothing is planned, sums and refusals are those of the rows."""
    rows = [row("Solo12", column) for column in COLUMNS]
    why = "LF needs 3.1 N m more, and 12 mm"
    rows[2] = row("Solo12", "chimney", planned=False, simulated="", words=why)
    rows[3] = row("Solo12", "wall", simulated="falls at 3.2 s")
    write_rows(tmp_path / FILE, rows)
    assert read_rows(tmp_path / FILE, Row) == rows
    out = io.StringIO()
    bench_zoo(True, out, folder=tmp_path)
    lines = out.getvalue().splitlines()
    assert lines[1].split()[:4] == ["Solo12", "2.5", "4", "3.0"]
    assert lines[1].count("stands") == 4
    assert "refused" in lines[1]
    assert "falls at 3.2 s" in lines[1]
    assert lines[2].startswith("5 of 6 cells planned and verified, 83 %; in simulation 4 of 5 do")
    assert lines[3] == f"  Solo12, chimney: {why}"


def test_tasks_that_are_not_asked_for_are_not_run(tmp_path: Path) -> None:
    write_rows(tmp_path / FILE, [row("Solo12", "ground")])
    out = io.StringIO()
    record = bench_zoo(True, out, folder=tmp_path, columns="ground")
    assert out.getvalue().splitlines()[1].count("not run") == len(COLUMNS) - 1
    assert [one["column"] for one in record["rows"]] == ["ground"]
    with pytest.raises(UsageError, match="no task 'sky', known are ground"):
        bench_zoo(True, out, folder=tmp_path, columns="ground, sky")


def test_a_robot_that_nothing_can_be_proposed_for(package: None, tmp_path: Path) -> None:
    out = io.StringIO()
    bench_zoo(False, out, "Solo", tmp_path)
    assert "0 of 6 cells" in out.getvalue()
    assert "expected three limbs or more" in out.getvalue()
    with (tmp_path / "results.csv").open(newline="") as stream:
        assert [line["column"] for line in csv.DictReader(stream)] == list(COLUMNS)


def test_other_robots_and_other_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no robot 'rex', known are A1"):
        bench_zoo(False, io.StringIO(), "a1, Rex")
    (tmp_path / "results.csv").write_text("name,value\n1,2\n")
    with pytest.raises(UsageError, match="no rows of Row"):
        bench_zoo(True, io.StringIO(), folder=tmp_path)


def test_every_robot_has_one_urdf(package: None) -> None:
    paths = [find_package_urdf(f"{PACKAGE}:{zoo.part}") for zoo in ROBOTS if not zoo.ours]
    assert len(set(paths)) == len(paths)


@pytest.mark.slow
def test_one_robot_is_planned_and_simulated(package: None, tmp_path: Path) -> None:
    bench_zoo(True, io.StringIO(), folder=tmp_path)
    rows = read_rows(tmp_path / FILE, Row)
    assert [one.column for one in rows] == list(COLUMNS)
    assert all(one.planned for one in rows), [one.words for one in rows]
    assert all(not one.simulated.startswith("falls") for one in rows)


def test_refusals_are_looked_at_again_and_kept(tmp_path: Path) -> None:
    words = "no spec: walking is of legs with 3 to 7 joints, got 2: knee, hip"
    rows = [row("hexapod", c, planned=c != "turn", words=words) for c in COLUMNS]
    write_rows(tmp_path / FILE, rows)
    for _ in range(2):
        out = io.StringIO()
        bench_zoo(False, out, "hexapod", tmp_path, "plans,refusals")
        assert "  hexapod, turn: limit of ours: walks are of legs with 3" in out.getvalue()
        assert "1 refusals looked at again" in out.getvalue()
    with (tmp_path / "refusals.csv").open(newline="") as stream:
        assert [line["verdict"] for line in csv.DictReader(stream)] == ["limit of ours"]
    with pytest.raises(UsageError, match="no table 'x', known are plans, refusals"):
        bench_zoo(False, io.StringIO(), "hexapod", tmp_path, "x")
