"""Random forests: votes of trees that each saw other rows and features (Breiman 2001).

Published: 150 trees, Gini impurity, depth 75 for strategies; 1000 trees for clusters of
ReDUCE, of which 150 are taken here unless more are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.quiet_training import quiet_training
from climbplan.learning.trees import LEAF, Trees, joined

_TREES_AT_ONCE = 20
_NUMBERS_AT_ONCE = 1e8  # that scikit-learn keeps at their nodes: 0.8 GB


@dataclass(frozen=True)
class Forest:
    """Trees whose leaves hold shares of classes, few of which are not zero."""

    trees: Trees
    first: IntArray  # (M + 1,) entries first[m] to first[m + 1] are those of node m; inner: none
    label: IntArray  # (E,) class of each entry
    share: Array  # (E,)
    classes: int

    def probabilities(self, features: Array) -> Array:
        """Mean share of each class (classes,) at features (p,)."""
        # Trees were grown on single precision: thresholds lie between such numbers.
        leaf = self.trees.leaves(features.astype(np.float32).astype(float))
        count = self.first[leaf + 1] - self.first[leaf]
        entry = np.repeat(self.first[leaf] - np.cumsum(count) + count, count)
        entry = entry + np.arange(len(entry))
        total = np.bincount(self.label[entry], self.share[entry], minlength=self.classes)
        return np.asarray(total / len(self.trees.root))

    def require(self, features: int) -> None:
        """Raises UsageError unless all numbers can be those of a forest over so many features."""
        self.trees.require(features)
        step = np.diff(self.first)
        sound = self.first[0] == 0 and self.first[-1] == len(self.label) and (step >= 0).all()
        leaf = self.trees.feature == LEAF
        if not sound or (step[leaf] == 0).any() or (step[~leaf] != 0).any():
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
    jobs: int = 1,
) -> Forest:
    """Grow a forest with scikit-learn; the same rows and seed give the same forest.

    features: (S, p). labels: (S,) below `classes`. depth: largest depth of a tree.
    """
    from sklearn.ensemble import RandomForestClassifier

    parts, label, share, count = [], [], [], []
    # scikit-learn keeps a number a class at every node: many trees of many classes do not fit into
    # memory at once, the few that are not zero do. Batches draw on, as one forest would.
    numbers = np.random.RandomState(seed)
    at_once = int(np.clip(_NUMBERS_AT_ONCE / (2 * len(features) * classes), 1, _TREES_AT_ONCE))
    for grown_trees in range(0, trees, at_once):
        grower = RandomForestClassifier(
            n_estimators=min(at_once, trees - grown_trees),
            criterion="gini",
            max_depth=depth,
            random_state=numbers,
            n_jobs=jobs,
        )
        with quiet_training():
            grower.fit(features, labels)
        known = np.asarray(grower.classes_, np.int64)
        for tree in grower.estimators_:
            grown = tree.tree_
            inner = grown.children_left >= 0
            parts.append(
                Trees(
                    root=np.zeros(1, np.int64),
                    feature=np.where(inner, grown.feature, LEAF).astype(np.int64),
                    threshold=np.where(inner, grown.threshold, 0.0),
                    left=np.where(inner, grown.children_left, LEAF).astype(np.int64),
                    right=np.where(inner, grown.children_right, LEAF).astype(np.int64),
                )
            )
            value = grown.value[:, 0, :] * ~inner[:, None]
            value = value / np.maximum(value.sum(axis=1), 1e-300)[:, None]
            node, column = np.nonzero(value)
            label.append(known[column])
            share.append(value[node, column])
            count.append(np.bincount(node, minlength=len(inner)))
    return Forest(
        trees=joined(parts),
        first=np.concatenate([[0], np.cumsum(np.concatenate(count))]).astype(np.int64),
        label=np.concatenate(label),
        share=np.concatenate(share),
        classes=classes,
    )
