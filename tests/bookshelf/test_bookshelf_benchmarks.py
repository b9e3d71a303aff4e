"""`python -m benchmarks bookshelf`: its figures agree with one another; times are not judged."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks.bookshelf.contenders import CONTENDERS, chosen
from benchmarks.bookshelf.inputs import FileGroup, bench_inputs, in_turn
from benchmarks.bookshelf.measure import Run, figures_of, wilson
from benchmarks.bookshelf.plots import write_plots
from benchmarks.bookshelf.published import compare_published, read_published
from benchmarks.bookshelf.run import (
    BenchOptions,
    BenchResult,
    as_json,
    bench_bookshelf,
    write_text,
)
from benchmarks.record import make_record
from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.generator import build_drop_shelf, generate_scenes
from climbplan.errors import PlanFileError, UsageError

SHIPPED = Path(__file__).parents[2] / "specs" / "bookshelf_scenes.h5"
OPTIONS = BenchOptions(
    count=3, some=2, few=1, library_size=25, seconds=2.0, methods="exact,convex-10,mpcc-manual"
)


def silent(stage: str, fraction: float) -> None:
    pass


@pytest.fixture(scope="module")
def result() -> BenchResult:
    return bench_bookshelf(OPTIONS, silent)


def test_figures_agree_with_one_another(result: BenchResult) -> None:
    kinds = [(row.method, row.meaning) for row in result.figures]
    assert kinds == [
        ("exact", "contact"),
        ("convex-10", "contact"),
        ("mpcc-manual", "contact"),
        ("convex-10", "published"),
        ("mpcc-manual", "published"),
    ]
    exact = result.figures[0]
    assert (exact.success, exact.proved, exact.cost_ratio) == (1.0, 3, 1.0)
    for row, run in zip(result.figures, result.runs, strict=True):
        assert 0 <= row.success_low <= row.success <= row.success_high <= 1
        assert row.success == np.isfinite(run.cost).mean()
        assert row.scenes == len(run.scene) == 3
        assert row.below_reference == 0
        assert row.bounds_above == 0
        assert math.isnan(row.within_1_percent) or 0 <= row.within_1_percent <= 1
        assert row.nontrivial_solved <= row.nontrivial <= row.scenes
        assert 0 < row.median_ms <= row.most99_ms <= row.max_ms
        assert (run.cost >= result.best[row.meaning][run.scene] - 0.01).all()


def test_json_text_and_plots(result: BenchResult, tmp_path: Path) -> None:
    read = make_record({}, "bookshelf", {}, as_json(result), "")["results"]
    assert read == json.loads(json.dumps(read, allow_nan=False))
    assert [row["method"] for row in read["methods"]] == [row.method for row in result.figures]
    assert len(read["scenes"]) == len(result.runs)
    text = io.StringIO()
    write_text(result, text)
    for words in ("meaning contact", "meaning published", "0 of ", "machine load", "8.1 "):
        assert words in text.getvalue()
    write_plots(result.runs, result.figures, result.best, tmp_path)
    for name in ("success", "cost", "time"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_scenes_are_the_seeds_and_the_files() -> None:
    one, same = (bench_inputs(None, 2, 7, silent).scenes for _ in range(2))
    assert (one.pose == same.pose).all()
    assert (bench_inputs(None, 2, 8, silent).scenes.pose != one.pose).any()
    shipped = bench_inputs(str(SHIPPED), 5, 0, silent)
    assert len(shipped.scenes) == 5
    assert (
        bench_inputs(f"{SHIPPED}:scenes", 5, 0, silent).scenes.pose == shipped.scenes.pose
    ).all()
    assert FileGroup.of("none.h5:test").group == "test"
    with pytest.raises(PlanFileError):
        bench_inputs("none.h5", 1, 0, silent)


def test_what_slow_methods_get_moves_in_every_other_scene() -> None:
    assert in_turn(np.array([0.0, 0.5, 9.0, 0.0, 4.0]), 1.0) == [2, 0, 4, 1, 3]


def test_wilson_interval() -> None:
    none, half, every = wilson(0, 10), wilson(50, 100), wilson(10, 10)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(0.2775, abs=1e-4)
    assert (half.low, half.high) == pytest.approx((0.4038, 0.5962), abs=1e-4)
    assert (every.value, every.high) == (1.0, 1.0)
    assert math.isnan(wilson(0, 0).value)


def test_wrong_bounds_and_answers_below_the_optimum_are_counted() -> None:
    def answer(cost: float) -> SceneAnswer:
        return SceneAnswer("feasible", None, cost, -math.inf, 0.001)

    best = np.array([10.0, 10.0, 10.0, 0.0])
    costs, claims = (10.05, 9.0, math.inf, 0.0), (12.0, -math.inf, math.inf, 0.0)
    run = Run(
        CONTENDERS[0],
        "contact",
        [0, 1, 2, 3],
        [answer(c) for c in costs],
        np.array(claims),
        0,
        None,
    )
    figures = figures_of(run, best, 0.01, 1e-4)
    assert (figures.bounds, figures.bounds_above) == (3, 2)  # the claim of `infeasible` is one
    assert figures.below_reference == 1
    assert figures.success == 0.75
    assert (figures.nontrivial, figures.nontrivial_solved) == (3, 2)
    assert figures.within_1_percent == pytest.approx(2 / 3)


def test_unknown_methods_are_refused() -> None:
    assert [contender.key for contender in chosen("mpcc-zero, exact")] == ["exact", "mpcc-zero"]
    with pytest.raises(UsageError, match="no method 'frob'"):
        chosen("frob")


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Optima of ours, but for the first scene, into which the book is forced where it overlaps."""
    scenes, shelf = generate_scenes(3, 12, 3), build_drop_shelf(3)
    answers = ExactSolver(shelf).solve_all(scenes)
    pose = np.stack([a.placement.pose for a in answers if a.placement is not None])
    costly = int(np.argmax([a.objective for a in answers]))
    pose[costly, :3] = scenes.pose[costly]
    point = np.zeros((len(scenes), 30))
    mm = pose * np.array([1e3, 1e3, 1.0])
    point[:, :6], point[:, 6:9] = mm[:, :3, :2].reshape(-1, 6), mm[:, :3, 2]
    point[:, 9:12] = mm[:, 3]
    path = tmp_path_factory.mktemp("published") / "published.h5"
    with h5py.File(path, "w") as file:
        file.attrs["units"] = "mm, rad"
        group = file.create_group("test")
        group["theta"], group["X"] = scenes.theta("mm"), point
        file.attrs["costly"] = costly
    return path


def test_published_placements_are_compared_at_equal_allowance(published: Path) -> None:
    with h5py.File(published) as file:
        costly = int(file.attrs["costly"])
    found = compare_published(f"{published}:test", ExactLimits(), silent)
    assert found.scenes == 12
    cheaper = [(row.scene, row.allowance) for row in found.rows if row.cheaper]
    first = next(row for row in found.rows if row.cheaper)
    assert cheaper[0] == (costly, "none")
    assert {scene for scene, _ in cheaper} == {costly}
    assert first.breaks == "book.overlap"
    assert first.by == pytest.approx(first.overlap_mm)
    assert first.published_mm2 == pytest.approx(0.0, abs=1e-6)
    assert not any(row.cheaper and not row.breaks for row in found.rows)
    assert (found.brought.cheaper, found.brought.comparable) == (0, 12)
    broken = next(b for b in found.broken if (b.meaning, b.name) == ("contact", "book.overlap"))
    assert broken.broken == 1
    same = [row for row in found.rows if row.scene != costly and row.allowance == "none"]
    for row in same:
        assert row.ours_mm2 == pytest.approx(row.published_mm2, abs=0.02, rel=1e-3)
    by_scene = {(row.scene, row.allowance): row.ours_mm2 for row in found.rows}
    for scene in range(12):
        costs = [by_scene[scene, allowance] for allowance in ("none", "overlap", "lengths")]
        assert costs[0] >= costs[1] - 0.02 >= costs[2] - 0.04


def test_published_files_without_placements_are_refused(published: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`theta` and `X`"):
        read_published(str(SHIPPED))
    with pytest.raises(UsageError, match="no such group"):
        read_published(f"{published}:frob")


def test_only_published_placements(published: Path) -> None:
    options = replace(OPTIONS, count=0, published=str(published))
    found = bench_bookshelf(options, silent)
    assert not found.runs
    text = io.StringIO()
    write_text(found, text)
    assert "12 scenes" in text.getvalue()
    record = make_record({}, "bookshelf", {}, as_json(found), "")
    assert json.dumps(record, allow_nan=False)
