"""Random forests: votes of trees, each grown on other rows and features (Breiman 2001).

The published forests have 150 trees with Gini impurity and depth 75 for strategies, and 1000 trees
for clusters of ReDUCE, of which 150 are the default here.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.learning.quiet_training import suppress_expected_warnings
from climbplan.learning.trees import LEAF, Trees, join_trees

_TREES_AT_ONCE = 20
_NUMBERS_AT_ONCE = 1e8  # numbers that scikit-learn stores at their nodes: 0.8 GB


@dataclass(frozen=True)
class Forest:
    """Trees whose leaves have fractions of classes, few of which are nonzero."""

    trees: Trees
    first: IntArray  # (M + 1,) entries first[m] to first[m + 1] are those of leaf m
    label: IntArray  # (E,) class of each entry
    share: Array  # (E,)
    classes: int

    def probabilities(self, features: Array) -> Array:
        """Return the mean fraction of each class (classes,) at features (p,)."""
        # Trees are grown in single precision: thresholds lie between such numbers
        leaf = self.trees.find_leaves(features.astype(np.float32).astype(float))
        count = self.first[leaf + 1] - self.first[leaf]
        entry = np.repeat(self.first[leaf] - np.cumsum(count) + count, count)
        entry = entry + np.arange(len(entry))
        total = np.bincount(self.label[entry], self.share[entry], minlength=self.classes)
        return np.asarray(total / len(self.trees.root))

    def require(self, features: int) -> None:
        """Check that the arrays can be those of a forest over some number of features.

        Raises:
            UsageError: They cannot.
        """
        self.trees.require(features)
        step = np.diff(self.first)
        is_sound = self.first[0] == 0 and self.first[-1] == len(self.label) and (step >= 0).all()
        leaf = self.trees.feature == LEAF
        if not is_sound or (step[leaf] == 0).any() or (step[~leaf] != 0).any():
            raise UsageError("forest: its leaves' entries do not follow one another")
        if ((self.label < 0) | (self.label >= self.classes)).any():
            raise UsageError(f"forest: a class that there is not (of {self.classes})")
        if not ((self.share > 0) & (self.share <= 1 + 1e-6)).all():
            raise UsageError("forest: a share that is not in (0, 1]")


def fit_forest(
    features: Array,
    labels: IntArray,
    classes: int,
    trees: int,
    depth: int,
    seed: int,
    *,
    jobs: int = 1,
) -> Forest:
    """Grow a forest with scikit-learn; the same rows and seed give the same forest.

    Args:
        features: (S, p).
        labels: (S,) classes below `classes`.
        classes: Number of classes.
        trees: Number of trees.
        depth: Largest depth of a tree.
        seed: Seed of the random numbers.
        jobs: Number of parallel jobs.
    """
    from sklearn.ensemble import RandomForestClassifier

    tree_arrays, label, fractions, count = [], [], [], []
    # scikit-learn stores a number for each class at every node, which is too much for many trees of
    # many classes; only nonzero ones are kept. Batches continue one random sequence.
    numbers = np.random.RandomState(seed)
    at_once = int(np.clip(_NUMBERS_AT_ONCE / (2 * len(features) * classes), 1, _TREES_AT_ONCE))
    for begin in range(0, trees, at_once):
        grower = RandomForestClassifier(
            n_estimators=min(at_once, trees - begin),
            criterion="gini",
            max_depth=depth,
            random_state=numbers,
            n_jobs=jobs,
        )
        with suppress_expected_warnings():
            grower.fit(features, labels)
        class_of_column = np.asarray(grower.classes_, np.int64)
        for tree in grower.estimators_:
            grown = tree.tree_
            inner = grown.children_left >= 0
            tree_arrays.append(_read_tree(grown, inner))
            value = grown.value[:, 0, :] * ~inner[:, None]
            value = value / np.maximum(value.sum(axis=1), 1e-300)[:, None]
            node, column = np.nonzero(value)
            label.append(class_of_column[column])
            fractions.append(value[node, column])
            count.append(np.bincount(node, minlength=len(inner)))
    return Forest(
        trees=join_trees(tree_arrays),
        first=np.concatenate([[0], np.cumsum(np.concatenate(count))]).astype(np.int64),
        label=np.concatenate(label),
        share=np.concatenate(fractions),
        classes=classes,
    )


def _read_tree(grown: Any, inner: BoolArray) -> Trees:
    """Read the nodes of scikit-learn's tree; inner: (M,) mask of nodes that are no leaves."""
    return Trees(
        root=np.zeros(1, np.int64),
        feature=np.where(inner, grown.feature, LEAF).astype(np.int64),
        threshold=np.where(inner, grown.threshold, 0.0),
        left=np.where(inner, grown.children_left, LEAF).astype(np.int64),
        right=np.where(inner, grown.children_right, LEAF).astype(np.int64),
    )
