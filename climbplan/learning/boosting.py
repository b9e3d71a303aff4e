"""Gradient boosting of a strategy's parts: each tree corrects the sum of the previous ones.

Hundreds of strategies would need as many trees in each round. A strategy is therefore decomposed
into its choices (binaries of which exactly one holds, single binaries, alternatives, labels). Each
choice has boosted trees, and the probability of a strategy is the product of those of its choices.
This assumes that choices are independent given the features. Strategies that are not in the library
are no candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.quiet_training import suppress_expected_warnings
from climbplan.learning.trees import LEAF, Trees, join_trees


@dataclass(frozen=True)
class Boosting:
    """H choices with R options together; each tree adds to the score of one option."""

    trees: Trees
    value: Array  # (M,) score of leaves
    option: IntArray  # (T,) option to whose score each tree adds
    baseline: Array  # (R,) scores without trees
    first: IntArray  # (H + 1,) options first[h] to first[h + 1] are those of choice h
    level: IntArray  # (U, H) option that each strategy takes

    def probabilities(self, features: Array) -> Array:
        """Return normalised products of the choices' probabilities (U,) at features (p,)."""
        leaf = self.trees.find_leaves(features)
        score = self.baseline + np.bincount(
            self.option, self.value[leaf], minlength=len(self.baseline)
        )
        logarithm = np.empty(len(score))
        for begin, end in zip(self.first[:-1], self.first[1:], strict=True):
            choice_score = score[begin:end]
            max_score = choice_score.max()
            logarithm[begin:end] = (
                choice_score - max_score - np.log(np.exp(choice_score - max_score).sum())
            )
        total = logarithm[self.level].sum(axis=1)
        power = np.exp(total - total.max())
        return np.asarray(power / power.sum())

    def require(self, features: int, classes: int) -> None:
        """Check that the arrays are those of boosted trees for such strategies.

        Raises:
            UsageError: They are not.
        """
        self.trees.require(features)
        R, H = len(self.baseline), len(self.first) - 1
        if len(self.value) != len(self.trees.feature) or len(self.option) != len(self.trees.root):
            raise UsageError("boosting: values or options do not fit its trees")
        if H < 1 or self.first[0] != 0 or self.first[-1] != R or (np.diff(self.first) < 1).any():
            raise UsageError("boosting: its choices' options do not follow one another")
        if ((self.option < 0) | (self.option >= R)).any():
            raise UsageError(f"boosting: a tree for an option that there is not (of {R})")
        if self.level.shape != (classes, H):
            raise UsageError(
                f"boosting: levels of shape {self.level.shape}, expected ({classes}, {H})"
            )
        if ((self.level < self.first[:-1]) | (self.level >= self.first[1:])).any():
            raise UsageError("boosting: a strategy takes an option of another choice")


def decompose_strategies(library: Library) -> list[IntArray]:
    """Decompose strategies into choices: the level (U,) of each choice that differs among them."""
    bits = library.strategies.astype(np.int64)
    columns: list[IntArray] = []
    begin = 0
    while begin < bits.shape[1]:
        running = np.cumsum(bits[:, begin:], axis=1)
        # The shortest run of binaries of which exactly one is 1 in every strategy
        run_ends = np.flatnonzero((running == 1).all(axis=0))
        end = begin + int(run_ends[0]) + 1 if len(run_ends) else begin + 1
        single = end == begin + 1
        columns.append(bits[:, begin] if single else np.argmax(bits[:, begin:end], axis=1))
        begin = end
    columns += list(library.strategy_alternatives.T) + list(library.strategy_labels.T)
    return [column for column in columns if len(np.unique(column)) > 1]


def fit_boosting(library: Library, rounds: int, rate: float, leaves: int, seed: int) -> Boosting:
    """Boost trees for each choice of a library's strategies with scikit-learn.

    Args:
        library: Solved problems.
        rounds: Number of trees for each option.
        rate: Learning rate.
        leaves: Largest number of leaves of a tree.
        seed: Seed of the random numbers.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier

    tree_arrays, values, options, baselines, firsts, levels = [], [], [], [], [0], []
    for column in decompose_strategies(library):
        levels_here, level = np.unique(column, return_inverse=True)
        start, count = firsts[-1], len(levels_here)
        booster = HistGradientBoostingClassifier(
            max_iter=rounds,
            learning_rate=rate,
            max_leaf_nodes=leaves,
            random_state=seed,
            early_stopping=False,
        )
        with suppress_expected_warnings():
            booster.fit(library.features, level[library.strategy])
        # scikit-learn has no public access to the trees: these names are tested in the suite.
        raw = np.asarray(booster._baseline_prediction, float).ravel()
        baselines.append(np.concatenate([[0.0], raw]) if count == 2 else raw)
        for round_trees in booster._predictors:
            for k, tree in enumerate(round_trees):
                grown_tree, value = _read_tree(tree.nodes)
                tree_arrays.append(grown_tree)
                values.append(value)
                options.append(start + k + (count == 2))
        levels.append(start + level)
        firsts.append(start + count)
    if not tree_arrays:
        return _build_single_choice(len(library.strategies))
    return Boosting(
        trees=join_trees(tree_arrays),
        value=np.concatenate(values),
        option=np.array(options, np.int64),
        baseline=np.concatenate(baselines),
        first=np.array(firsts, np.int64),
        level=np.column_stack(levels).astype(np.int64),
    )


def _read_tree(nodes: np.ndarray[Any, Any]) -> tuple[Trees, Array]:
    """Read a tree and the values of its leaves (M,) from scikit-learn's records of nodes."""
    leaf = nodes["is_leaf"].astype(bool)
    tree = Trees(
        root=np.zeros(1, np.int64),
        feature=np.where(leaf, LEAF, nodes["feature_idx"].astype(np.int64)),
        threshold=np.where(leaf, 0.0, nodes["num_threshold"]),
        left=np.where(leaf, LEAF, nodes["left"].astype(np.int64)),
        right=np.where(leaf, LEAF, nodes["right"].astype(np.int64)),
    )
    return tree, np.where(leaf, nodes["value"], 0.0)


def _build_single_choice(num_strategies: int) -> Boosting:
    """Build the boosting of a single choice without alternatives, for equal strategies."""
    leaf = np.array([LEAF])
    stump = Trees(np.array([0]), leaf, np.zeros(1), leaf, leaf)
    return Boosting(
        stump,
        np.zeros(1),
        np.zeros(1, np.int64),
        np.zeros(1),
        np.array([0, 1]),
        np.zeros((num_strategies, 1), np.int64),
    )
