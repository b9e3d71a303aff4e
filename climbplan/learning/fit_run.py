"""Train a strategy from a spec: evaluate on held-out problems, then train on all."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.learning.clusters import OUTLIER, ClusterOptions
from climbplan.learning.evaluation import RankingEvaluation, evaluate, select_held_out
from climbplan.learning.library import Library
from climbplan.learning.model import FitOptions, StrategyModel, fit_strategy
from climbplan.learning.model_file import ModelFile, mark_verified, read_model, write_model
from climbplan.progress import Progress
from climbplan.schema.learning.strategy import StrategySpec
from climbplan.schema.learning.strategy_loading import LoadedStrategy

_CHECKED_ROWS = 20  # problems whose candidates must be equal after reading the file back
_CHECKED_CANDIDATES = 10


@dataclass(frozen=True)
class TrainingData:
    """Solved problems and the data of their kind."""

    library: Library
    group: IntArray  # (S,) rows of equal groups are never on both sides of a split
    hard: BoolArray  # (S,) problems that are reported separately
    columns: IntArray  # variables by which solutions are clustered
    context: Mapping[str, Any]  # values that a problem must share
    scale: Array | None = None  # (p,) of features in distances
    hard_means: str = ""


@dataclass(frozen=True)
class TrainedModel:
    """A model of all rows, and the evaluation of one of fewer rows on the held-out rows."""

    model: StrategyModel
    evaluation: RankingEvaluation | None  # None if nothing was held out
    test_rows: int
    seconds: Mapping[str, float] = field(default_factory=dict)


def build_fit_options(spec: StrategySpec) -> FitOptions:
    """Build training options from a spec."""
    model = spec.model
    return FitOptions(
        kind=model.kind,
        trees=model.forest.trees,
        depth=model.forest.depth,
        hidden=model.network.hidden,
        epochs=model.network.epochs,
        rounds=model.boosting.rounds,
        rate=model.boosting.rate,
        leaves=model.boosting.leaves,
        cluster_trees=model.reduce.trees,
        clusters=ClusterOptions(
            method=model.reduce.clusters,
            least=model.reduce.least,
            distance=model.reduce.distance,
            count=model.reduce.count,
            outliers=model.reduce.outliers,
        ),
        seed=spec.seed,
    )


def train(
    data: TrainingData,
    options: FitOptions,
    held_out_fraction: float = 0.1,
    report: Progress | None = None,
) -> TrainedModel:
    """Evaluate on a fraction of the problems, then train on all of them.

    Raises:
        UsageError: The library is empty, or no cluster is found.
    """
    report = report or _ignore_progress
    begin = time.perf_counter()
    is_held_out = select_held_out(data.group, held_out_fraction, options.seed)
    evaluation = None
    if is_held_out.any() and not is_held_out.all():
        report("measure", 0.0)
        training_rows, test = (
            data.library.subset(np.flatnonzero(~is_held_out)),
            np.flatnonzero(is_held_out),
        )
        partial = fit_strategy(training_rows, options, data.columns, data.scale)
        evaluation = evaluate(partial, data.library.subset(test), data.hard[test])
    measured = time.perf_counter()
    report("train", 0.5)
    model = fit_strategy(data.library, options, data.columns, data.scale, data.context)
    trained = time.perf_counter()
    seconds = {"measure": measured - begin, "train": trained - measured}
    return TrainedModel(model, evaluation, int(is_held_out.sum()), seconds)


def build_model_file(
    trained: TrainedModel, loaded: LoadedStrategy, data: TrainingData
) -> ModelFile:
    """Build the content of the model file."""
    figures: dict[str, Any] = {
        "rows": trained.model.library.size,
        "groups": len(np.unique(data.group)),
        "strategies": len(trained.model.library.strategies),
        "held_out_rows": trained.test_rows,
        "hard_means": data.hard_means,
    }
    if trained.model.cluster is not None:
        inside = trained.model.cluster[trained.model.cluster != OUTLIER]
        sizes = np.bincount(inside)
        figures["clusters"] = len(sizes)
        figures["cluster_sizes"] = [int(size) for size in sizes]
        figures["outliers"] = trained.model.library.size - len(inside)
    if trained.evaluation is not None:
        figures["evaluation"] = _replace_nan(trained.evaluation.as_dict())
    return ModelFile(
        model=trained.model,
        name=loaded.name,
        title=loaded.spec.title,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        fit=figures,
        timings=dict(trained.seconds),
    )


def write_verified(stored: ModelFile, path: Path) -> ModelFile:
    """Write a model, read it back, and mark it verified if its candidates are the same.

    Raises:
        UsageError: The file cannot be written.
    """
    write_model(stored, path)
    library = stored.model.library
    before, after = stored.model.create_strategy(), read_model(path).model.create_strategy()
    rows = np.linspace(0, library.size - 1, min(_CHECKED_ROWS, library.size)).astype(int)
    same = all(
        [c.row for c in before.candidates(library.features[k], _CHECKED_CANDIDATES)]
        == [c.row for c in after.candidates(library.features[k], _CHECKED_CANDIDATES)]
        for k in rows
    )
    done = mark_verified(stored, same)
    write_model(done, path)
    return done


def _replace_nan(value: Any) -> Any:
    """Replace NaN, which JSON does not support, by None."""
    if isinstance(value, dict):
        return {key: _replace_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_replace_nan(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _ignore_progress(stage: str, fraction: float) -> None:
    """Ignore a progress report."""
    pass
