"""The public set of contact problems: what is written says what was stated, and is judged anew."""

from __future__ import annotations

import csv
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.instances.run import (
    Row,
    bench_instances,
    best_values,
    known_rows,
    shifted_mean,
    solved_by,
)
from climbplan.errors import UsageError
from climbplan.instances import check_solution as checker
from climbplan.instances.families import FAMILIES, LEVELS, NamedInstance, list_instances
from climbplan.instances.writing import build_file_point, read_known_values, write_set
from climbplan.solvers.registry import solve
from climbplan.solvers.tree.normal_form import build_normal_form
from climbplan.solvers.tree.search import TreeSearch

_QUICK = {"postures": "scip", "forces": "highs", "cart-poles": "branch-and-bound",
          "free-flyers": "branch-and-bound", "coupled": "minlp-scip"}  # fmt: skip


def _named(family: str, level: str = "easy", number: int = 0) -> NamedInstance:
    return next(n for n in list_instances(number + 1) if n.name == f"{family}-{level}-{number}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("set")
    assert write_set(target, 0, 1, lambda stage, share: None) == 24
    return target


def test_at_least_200_instances_of_eight_families_in_three_classes() -> None:
    assert len({named.name for named in list_instances()}) >= 200
    assert len(FAMILIES) == 8
    assert len(LEVELS) == 3


@pytest.mark.parametrize("family", [f.name for f in FAMILIES])
def test_a_name_and_a_seed_are_one_problem(family: str) -> None:
    one, same = _named(family).generate(3), _named(family).generate(3)
    other = _named(family, number=1).generate(3)
    assert (one.A != same.A).nnz == 0
    assert np.array_equal(one.row_upper, same.row_upper)
    assert np.array_equal(one.q, same.q)

    def numbers(instance: object) -> bytes:
        parts = [instance.A.data, instance.row_upper, instance.lower, instance.q]  # type: ignore[attr-defined]
        parts += [p.b for c in instance.choices for p in c.alternatives]  # type: ignore[attr-defined]
        return b"".join(np.asarray(part).tobytes() for part in parts)

    assert numbers(one) == numbers(same)
    assert numbers(one) != numbers(other)


@pytest.mark.parametrize(("family", "solver"), _QUICK.items())
def test_another_library_reads_what_was_written(folder: Path, family: str, solver: str) -> None:
    named = _named(family)
    instance = named.generate(0)
    found = solve(instance, solver, 1e-4, 20.0)
    assert found.x is not None
    path = next(p for p in folder.glob(f"{named.name}.*") if p.suffix in (".mps", ".nl"))
    model = checker.read_instance(path)
    point = build_file_point(instance, found.x, found.assignment)
    verdict = checker.check(model, point)
    assert verdict.feasible
    assert verdict.objective == pytest.approx(found.objective, rel=1e-6, abs=1e-9)
    # A point that breaks a row, a bound or a whole number is told so
    moved = {**point, "x0": point["x0"] + 5.0}
    assert not checker.check(model, moved).feasible
    with pytest.raises(ValueError, match="no variable 'y'"):
        checker.check(model, {**point, "y": 0.0})


def test_a_fraction_is_no_binary(folder: Path) -> None:
    named = _named("cart-poles")
    instance = named.generate(0)
    model = checker.read_instance(folder / f"{named.name}.mps")
    found = solve(instance, "branch-and-bound")
    assert found.x is not None
    point = build_file_point(instance, found.x, None)
    point[f"x{int(np.flatnonzero(instance.integer)[0])}"] = 0.5
    assert checker.check(model, point).integrality == 0.5


def test_the_checker_is_a_script_of_its_own(folder: Path, tmp_path: Path) -> None:
    instance = _named("cart-poles").generate(0)
    found = solve(instance, "branch-and-bound")
    assert found.x is not None
    lines = [f"{n} {v!r}" for n, v in build_file_point(instance, found.x, None).items()]
    (tmp_path / "a.sol").write_text("# a comment\n" + "\n".join(lines))
    (tmp_path / "b.sol").write_text("x0 one\n")
    file = folder / "cart-poles-easy-0.mps"
    script = folder / "check_solution.py"
    assert "climbplan" not in script.read_text()

    def run(solution: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-I", str(script), str(file), str(tmp_path / solution)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    good, bad = run("a.sol"), run("b.sol")
    assert good.returncode == 0
    assert good.stdout.endswith(": feasible\n")
    assert bad.returncode == 2
    assert "b.sol:1: expected `name value`" in bad.stderr


@pytest.mark.parametrize("rows", [" N COST\n E\n", " N COST\n E$row\n", " N COST\n"])
def test_rows_that_a_reader_crashes_on(
    rows: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, solution = tmp_path / "cut.mps", tmp_path / "cut.sol"
    path.write_text(f"NAME cut\nROWS\n{rows}")
    solution.write_text("x 1\n")
    assert checker.main([str(path), str(solution)]) == 2
    assert "cut.mps" in capsys.readouterr().err


def test_the_table_has_a_line_for_each_file(folder: Path) -> None:
    with (folder / "instances.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["class"] for row in rows} == set(LEVELS)
    for row in rows:
        assert (folder / row["file"]).exists()
        if row["best_known"] and row["bound"]:
            assert float(row["bound"]) <= float(row["best_known"]) + 1e-9
    assert sum(row["status"] == "optimal" for row in rows) >= 8


def test_known_values_are_of_the_set_and_hold() -> None:
    known = read_known_values()
    assert set(known) == {named.name for named in list_instances()}
    for family in ("cart-poles", "free-flyers"):
        for number in (0, 4):
            named = _named(family, "easy", number)
            told, found = known[named.name], solve(named.generate(0), "branch-and-bound")
            if told.infeasible:
                assert found.status == "infeasible"
            else:
                assert found.objective == pytest.approx(told.value, rel=2e-4)


def test_a_comparison_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = [f for f in FAMILIES if f.name == "free-flyers"]
    monkeypatch.setattr("climbplan.instances.families.FAMILIES", own)
    bench_instances(0, False, io.StringIO(), tmp_path, 1, 1.0, "scip,highs")
    first = (tmp_path / "results.csv").read_text()
    assert len(first.splitlines()) == 7
    begun = "\n".join(first.splitlines()[:4]) + "\n"
    (tmp_path / "results.csv").write_text(begun)
    stream = io.StringIO()
    bench_instances(0, False, stream, tmp_path, 1, 1.0, "scip,highs")
    again = (tmp_path / "results.csv").read_text()
    assert again.startswith(begun)
    assert len(again.splitlines()) == 7
    assert "free-flyers" in stream.getvalue()
    assert len((tmp_path / "known.csv").read_text().splitlines()) == 4
    assert len(list((tmp_path / "solutions").glob("*.sol"))) == 3


def _row(contender: str, status: str, objective: float, bound: float, cpu: float = 1.0) -> Row:
    return Row("a", "f", "easy", contender, 0, 10.0, status, objective, bound, cpu, 1)


def test_a_bound_that_a_checked_point_refutes_counts_for_nothing() -> None:
    rows = [
        _row("tree", "optimal", 2.0, 2.0),
        _row("scip", "infeasible", np.nan, np.inf),
        _row("highs", "feasible", 2.5, 2.4),
        _row("bonmin", "feasible", 2.00001, -np.inf),
    ]
    assert best_values(rows) == {"a": 2.0}
    assert [solved_by(r, 2.0, r.contender != "bonmin") for r in rows] == [True, False, False, True]
    assert known_rows(rows, 0) == [("a", "2.0", "2.0", "", "tree")]
    assert known_rows(rows[1:2], 0) == [("a", "", "inf", "yes", "")]


def test_means_are_shifted_geometric_ones() -> None:
    assert shifted_mean([1.0, 1.0]) == pytest.approx(1.0)
    assert shifted_mean([0.0, 10.0]) == pytest.approx(np.sqrt(0.1 * 10.1) - 0.1)


def test_unknown_solvers_are_refused() -> None:
    with pytest.raises(UsageError, match="no 'cplex', known are tree"):
        bench_instances(0, True, io.StringIO(), names="cplex")


def test_a_node_left_without_a_bound_proves_nothing() -> None:
    instance = _named("free-flyers").generate(0)
    search = TreeSearch(instance, build_normal_form(instance), 1e-4, np.inf, 1e-7)
    assert search.proves_infeasible  # nothing is open, nothing was left
    search.closed_bound = -np.inf
    assert not search.proves_infeasible
