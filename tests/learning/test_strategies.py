"""Trained strategies: our predictions are those of the trainer, through one interface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from learned_rows import FRAME, made_up, stored_model
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.neural_network import MLPClassifier

from climbplan.errors import UsageError
from climbplan.learning import forest
from climbplan.learning.boosting import decompose_strategies, fit_boosting
from climbplan.learning.evaluation import evaluate, select_held_out
from climbplan.learning.forest import fit_forest
from climbplan.learning.library import Library
from climbplan.learning.model import MODEL_KINDS, FitOptions, ModelKind, StrategyModel, fit_strategy
from climbplan.learning.model_file import read_model, write_model
from climbplan.learning.network import fit_network
from climbplan.learning.quiet_training import suppress_expected_warnings
from climbplan.learning.ranking import RankedStrategies
from climbplan.learning.trees import LEAF, Trees

SMALL = FitOptions(
    trees=20, depth=10, hidden=(16,), epochs=250, rounds=15, leaves=8, cluster_trees=20
)
COLUMNS = np.array([0, 1])


def _fit(kind: ModelKind, library: Library | None = None, seed: int = 0) -> StrategyModel:
    options = FitOptions(**{**vars(SMALL), "kind": kind, "seed": seed})
    return fit_strategy(library or made_up(), options, COLUMNS)


def _fresh(count: int = 50) -> np.ndarray:
    return np.random.default_rng(7).normal(size=(count, 3))


@pytest.mark.parametrize("numbers", [1e8, 1.0])
def test_forest_agrees_with_its_trainer(numbers: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many trees fit into memory at once."""
    monkeypatch.setattr(forest, "_NUMBERS_AT_ONCE", numbers)
    library = made_up()
    ours = fit_forest(library.features, library.strategy, len(library.strategies), 45, 10, 3)
    theirs = RandomForestClassifier(45, max_depth=10, random_state=3)
    theirs.fit(library.features, library.strategy)
    for x in _fresh():
        np.testing.assert_allclose(ours.probabilities(x), theirs.predict_proba([x])[0], atol=1e-12)


def test_network_agrees_with_its_trainer() -> None:
    library = made_up()
    ours = fit_network(library.features, library.strategy, len(library.strategies), (16,), 30, 3)
    scaled = (library.features - library.features.mean(0)) / library.features.std(0)
    theirs = MLPClassifier(
        (16,), batch_size=64, learning_rate_init=1e-3, alpha=1e-4, max_iter=30, random_state=3
    )
    with suppress_expected_warnings():
        theirs.fit(scaled, library.strategy)
    for x in _fresh():
        z = (x - library.features.mean(0)) / library.features.std(0)
        np.testing.assert_allclose(ours.probabilities(x), theirs.predict_proba([z])[0], atol=1e-9)


def test_boosting_agrees_with_its_trainer_choice_by_choice() -> None:
    library = made_up()
    ours = fit_boosting(library, 15, 0.1, 8, 3)
    expected = np.ones((50, len(library.strategies)))
    columns = decompose_strategies(library)
    assert [len(np.unique(c)) for c in columns] == [3, 2, 2, 2]  # one-of groups are found
    for column in columns:
        names, level = np.unique(column, return_inverse=True)
        theirs = HistGradientBoostingClassifier(
            max_iter=15, learning_rate=0.1, max_leaf_nodes=8, early_stopping=False, random_state=3
        ).fit(library.features, level[library.strategy])
        assert len(names) == len(theirs.classes_)
        expected *= theirs.predict_proba(_fresh())[:, level]
    expected /= expected.sum(axis=1, keepdims=True)
    for k, x in enumerate(_fresh()):
        np.testing.assert_allclose(ours.probabilities(x), expected[k], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("kind", MODEL_KINDS)
def test_same_seed_same_model_and_file(kind: ModelKind, tmp_path: Path) -> None:
    first, second = _fit(kind), _fit(kind)
    write_model(stored_model(first), tmp_path / "model.h5")
    read = read_model(tmp_path / "model.h5").model
    assert read.kind == kind
    for x in _fresh(10):
        ranked = [
            [(c.number, c.row, c.score) for c in model.create_strategy().candidates(x, 12)]
            for model in (first, second, read)
        ]
        assert ranked[0] == ranked[1] == ranked[2]


@pytest.mark.parametrize("kind", MODEL_KINDS)
def test_right_integers_come_early(kind: ModelKind) -> None:
    test = made_up(60, seed=9)
    found = evaluate(_fit(kind), test, np.arange(60) < 20)
    chance = evaluate(_fit(kind, _shuffled()), test, np.zeros(60, bool))
    assert found.compute_recall(5) >= 0.8
    assert found.compute_recall(5) > chance.compute_recall(5) + 0.1
    assert found.compute_recall(1) <= found.compute_recall(5) <= found.compute_recall(50)
    assert found.as_dict()["hard_problems"] == 20


def _shuffled() -> Library:
    library = made_up()
    order = np.random.default_rng(1).permutation(library.size)
    return Library.of(
        FRAME, library.features, library.points[order], library.objective, labels=library.labels
    )


def test_candidates_start_at_the_nearest_problem_of_each_strategy() -> None:
    library = made_up()

    class Even:
        def probabilities(self, features: np.ndarray) -> np.ndarray:
            return np.full(len(library.strategies), 1 / len(library.strategies))

    x = _fresh(1)[0]
    found = RankedStrategies(library, Even(), np.ones(3)).candidates(x, 100)
    distance = np.linalg.norm(library.features - x, axis=1)
    assert len(found) == len(library.strategies)
    assert [distance[c.row] for c in found] == sorted(distance[c.row] for c in found)
    for c in found:
        mine = library.strategy == c.number
        assert distance[c.row] == distance[mine].min()
        np.testing.assert_array_equal(c.start, library.points[c.row])


@pytest.mark.parametrize("kind", MODEL_KINDS)
def test_features_that_do_not_fit_are_refused(kind: ModelKind) -> None:
    strategy = _fit(kind).create_strategy()
    for wrong in (np.zeros(2), np.array([0.0, np.nan, 0.0])):
        with pytest.raises(UsageError, match="3 finite features expected"):
            strategy.candidates(wrong, 3)


@pytest.mark.parametrize("kind", MODEL_KINDS)
def test_one_strategy_alone(kind: ModelKind, tmp_path: Path) -> None:
    library = made_up()
    one = library.subset(np.flatnonzero(library.strategy == 0))
    write_model(stored_model(_fit(kind, one)), tmp_path / "model.h5")
    found = read_model(tmp_path / "model.h5").model.create_strategy().candidates(np.zeros(3), 5)
    assert found[0].number == 0


def test_split_keeps_groups_together() -> None:
    groups = np.repeat(np.arange(20), 2)
    aside = select_held_out(groups, 0.25, 4)
    assert aside.sum() == 10
    assert (aside[::2] == aside[1::2]).all()
    assert (aside == select_held_out(groups, 0.25, 4)).all()


def test_calibration_counts_every_problem_once() -> None:
    found = evaluate(_fit("forest"), made_up(60, seed=9), np.zeros(60, bool))
    bins = found.compute_calibration()
    assert sum(entry["problems"] for entry in bins) == 60
    assert all(0 <= entry["observed"] <= 1 for entry in bins)


def _stump(**changes: object) -> Trees:
    parts = {
        "root": np.array([0]),
        "feature": np.array([0, LEAF, LEAF]),
        "threshold": np.zeros(3),
        "left": np.array([1, LEAF, LEAF]),
        "right": np.array([2, LEAF, LEAF]),
    }
    return Trees(**{**parts, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changes",
    [
        {"left": np.array([0, LEAF, LEAF])},  # round in a circle
        {"right": np.array([3, LEAF, LEAF])},
        {"left": np.array([LEAF, LEAF, LEAF])},
        {"feature": np.array([3, LEAF, LEAF])},
        {"feature": np.array([-2, LEAF, LEAF])},
        {"threshold": np.array([np.inf, 0, 0])},
        {"root": np.array([1])},
        {"root": np.array([0, 0])},
        {"root": np.array([0, 3])},
        {"root": np.array([0, 1])},  # a child in another tree
    ],
)
def test_trees_that_are_none_are_refused(changes: dict[str, np.ndarray]) -> None:
    _stump().require(3)
    with pytest.raises(UsageError, match="trees"):
        _stump(**changes).require(3)
