"""Training a strategy as a spec asks for it: hold problems out, measure, then train on all."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.learning.clusters import OUTLIER, ClusterOptions
from climbplan.learning.evaluation import Evaluation, evaluate, held_out
from climbplan.learning.library import Library
from climbplan.learning.model import FitOptions, StrategyModel, fit
from climbplan.learning.model_file import ModelFile, marked, read_model, write_model
from climbplan.progress import Progress
from climbplan.schema.learning.strategy import StrategySpec
from climbplan.schema.learning.strategy_loading import LoadedStrategy

_CHECKED_ROWS = 20  # problems whose candidates must be the same after reading a file back
_CHECKED_CANDIDATES = 10


@dataclass(frozen=True)
class TrainingData:
    """Solved problems and what their kind knows of them."""

    library: Library
    group: IntArray  # (S,) rows of equal groups are never on both sides of a split
    hard: BoolArray  # (S,) problems that are reported apart
    columns: IntArray  # variables that solutions are clustered by
    context: Mapping[str, Any]  # that a problem must share to be served
    scale: Array | None = None  # (p,) of features in distances
    hard_means: str = ""


@dataclass(frozen=True)
class Trained:
    """A model of all rows, and how well one of fewer did on the rows kept from it."""

    model: StrategyModel
    evaluation: Evaluation | None  # None if nothing was held out
    test_rows: int
    seconds: Mapping[str, float] = field(default_factory=dict)


def options_of(spec: StrategySpec) -> FitOptions:
    """Training options as a spec has them."""
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
    data: TrainingData, options: FitOptions, share: float = 0.1, report: Progress | None = None
) -> Trained:
    """Measure on a share of the problems, then train on all of them.

    Raises as `model.fit` does.
    """
    report = report or _silent
    begin = time.perf_counter()
    aside = held_out(data.group, share, options.seed)
    evaluation = None
    if aside.any() and not aside.all():
        report("measure", 0.0)
        rest, test = data.library.subset(np.flatnonzero(~aside)), np.flatnonzero(aside)
        partial = fit(rest, options, data.columns, data.scale)
        evaluation = evaluate(partial, data.library.subset(test), data.hard[test])
    measured = time.perf_counter()
    report("train", 0.5)
    model = fit(data.library, options, data.columns, data.scale, data.context)
    trained = time.perf_counter()
    seconds = {"measure": measured - begin, "train": trained - measured}
    return Trained(model, evaluation, int(aside.sum()), seconds)


def stored_model(trained: Trained, loaded: LoadedStrategy, data: TrainingData) -> ModelFile:
    """What goes into the model file."""
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
        figures["evaluation"] = _plain(trained.evaluation.as_dict())
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
    """Write a model, read it back, and mark it verified if its candidates are still the same.

    Raises UsageError if it cannot be written.
    """
    write_model(stored, path)
    library = stored.model.library
    before, after = stored.model.strategy(), read_model(path).model.strategy()
    rows = np.linspace(0, library.size - 1, min(_CHECKED_ROWS, library.size)).astype(int)
    same = all(
        [c.row for c in before.candidates(library.features[k], _CHECKED_CANDIDATES)]
        == [c.row for c in after.candidates(library.features[k], _CHECKED_CANDIDATES)]
        for k in rows
    )
    done = marked(stored, same)
    write_model(done, path)
    return done


def _plain(value: Any) -> Any:
    """Without NaN, which JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _silent(stage: str, fraction: float) -> None:
    pass
