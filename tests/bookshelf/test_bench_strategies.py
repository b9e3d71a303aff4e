"""`python -m benchmarks strategies`: its figures agree with one another; times are not judged."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymunk")

from benchmarks.bookshelf.cluster_programs import WHOLE
from benchmarks.bookshelf.strategies import (
    CANDIDATES,
    StrategyOptions,
    StrategyResult,
    as_json,
    bench_strategies,
)
from benchmarks.bookshelf.strategy_cases import (
    KINDS,
    case_of,
    drawn_scenes,
    training_scenes,
)
from benchmarks.bookshelf.strategy_plots import comparison
from benchmarks.bookshelf.strategy_tables import write_text
from benchmarks.record import make_record
from climbplan.bookshelf.methods.features import build_feature_map
from climbplan.bookshelf.scene.generator import build_drop_shelf
from climbplan.bookshelf.statement.points import build_theta
from climbplan.errors import UsageError

OPTIONS = StrategyOptions(
    count=4, some=2, few=3, clusters=1, seconds=3.0, library_size=110, methods="reduce,knn"
)


def silent(stage: str, fraction: float) -> None:
    pass


@pytest.fixture(scope="module")
def result() -> StrategyResult:
    return bench_strategies(OPTIONS, silent)


@pytest.mark.slow
def test_figures_agree_with_one_another(result: StrategyResult) -> None:
    assert {row.contender for row in result.figures} == {"exact", "knn", "reduce"}
    assert {row.setting for row in result.figures} == set(KINDS)
    for row in result.figures:
        assert 0 <= row.success <= row.fallback <= 1
        assert row.scenes >= row.hard
        assert math.isnan(row.within) == (row.hard == 0)
        if row.contender == "exact":
            assert (row.success, row.fallback) == (1.0, 1.0)
        elif math.isfinite(row.deterioration):
            assert row.deterioration >= -0.05  # optima are to 0.01 mm^2
    knn = [row for row in result.figures if row.contender == "knn"]
    assert {row.rows for row in knn if row.setting == "same"} == {100, 110}
    assert {row.rows for row in knn if row.setting != "same"} == {110}
    for setting in KINDS:
        mine = [row for row in knn if row.setting == setting and row.rows == 110]
        assert [row.candidates for row in mine] == list(CANDIDATES)
        assert (np.diff([row.success for row in mine]) >= 0).all()
        assert (np.diff([row.mean_ms for row in mine]) >= 0).all()


@pytest.mark.slow
def test_reduced_programs_are_counted(result: StrategyResult) -> None:
    rows = [row for row in result.figures if row.contender == "reduce"]
    assert all(row.scenes == 2 or row.setting != "same" for row in rows)
    assert all(0 <= row.by_program <= 1 for row in rows)
    assert result.clusters
    reduced = [trial for trial in result.programs if trial.cluster != WHOLE]
    whole = [trial for trial in result.programs if trial.cluster == WHOLE]
    assert [trial.solver for trial in reduced] == ["highs", "scip"]
    assert [trial.solver for trial in whole] == ["highs", "scip"]
    assert all(trial.binaries == 130 for trial in whole)  # as published
    for trial in result.programs:
        assert trial.binaries <= 130
        assert trial.exact >= trial.optimum - 0.05
        if trial.status not in ("optimal", "feasible"):
            assert math.isinf(trial.exact)


@pytest.mark.slow
def test_record_and_tables_hold_the_figures(result: StrategyResult) -> None:
    record = make_record({}, "strategies", {}, as_json(result), "")["results"]
    assert record == json.loads(json.dumps(record, allow_nan=False))
    assert len(record["figures"]) == len(result.figures)
    assert record["cluster_programs"][0]["binaries"] == result.programs[0].binaries
    stream = io.StringIO()
    write_text(result, stream)
    text = stream.getvalue()
    for setting, kind in KINDS.items():
        assert f"{setting}: {kind.meaning}" in text
    assert (
        len([line for line in text.splitlines() if line.startswith(("reduced  ", "whole  "))]) == 4
    )


@pytest.mark.slow
def test_the_picture_names_every_strategy_once(result: StrategyResult) -> None:
    figure = comparison(result)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["knn", "reduce", "exact"]
    assert len(figure.axes) == 6


def test_scenes_unlike_the_data_mostly_need_movement() -> None:
    scenes = drawn_scenes("slender", 1, 20, silent, "")
    again = drawn_scenes("slender", 1, 20, silent, "")
    assert all((a.pose == b.pose).all() for a, b in zip(scenes, again, strict=True))
    assert all((scene.size[:, 1] <= 0.0201).all() for scene in scenes)
    assert all(0.0399 <= scene.inserted[1] <= 0.0701 for scene in scenes)
    shelf = build_drop_shelf(3, KINDS["slender"].rules)
    assert shelf == build_drop_shelf(3)  # the shelf that was trained on
    case = case_of("slender", scenes, shelf, 10.0)
    assert len(case.scenes) == 20
    assert (case.optimum > 1).mean() > 0.7


def test_no_test_scene_is_trained_on() -> None:
    training = training_scenes(None, 12, 0, silent)
    assert training.rows.library.size == 24  # mirrored
    assert training.model("knn", 5, 0).library.size == 10
    features = build_feature_map("gaps", training.shelf)
    seen = training.rows.library.features
    for scene in drawn_scenes("same", 1, 12, silent, ""):
        assert np.abs(seen - features(build_theta(scene))).max(axis=1).min() > 0.1


def test_unknown_strategies_and_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no strategy 'tea'"):
        bench_strategies(StrategyOptions(methods="knn,tea"), silent)
