"""Decision trees as plain arrays, all nodes of all trees one after the other.

A child always follows its single parent, so a walk from a root always ends, after at most the depth
that a spec may require. Files with other trees are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError

LEAF = -1
MAX_DEPTH = 1000  # largest depth, which limits the time of a walk


@dataclass(frozen=True)
class Trees:
    """T trees with M nodes together."""

    root: IntArray  # (T,) first node of each tree, increasing
    feature: IntArray  # (M,) feature compared at the node, LEAF at leaves
    threshold: Array  # (M,) the walk goes left where the feature is at most this
    left: IntArray  # (M,) LEAF at leaves
    right: IntArray  # (M,)

    def find_leaves(self, features: Array) -> IntArray:
        """Return the leaf (T,) of each tree at features (p,)."""
        node = self.root.copy()
        while True:
            feature = self.feature[node]
            inner = feature >= 0
            if not inner.any():
                return node
            inner_node = node[inner]
            low = features[feature[inner]] <= self.threshold[inner_node]
            node[inner] = np.where(low, self.left[inner_node], self.right[inner_node])

    def require(self, features: int) -> None:
        """Check that these are trees over some number of features.

        Raises:
            UsageError: They are not.
        """
        M, T = len(self.feature), len(self.root)
        inner = self.feature != LEAF
        if not T or self.root[0] != 0 or (np.diff(self.root) <= 0).any() or self.root[-1] >= M:
            raise UsageError("trees: roots are not increasing nodes from 0 on")
        if (self.feature < LEAF).any() or (self.feature >= features).any():
            raise UsageError(f"trees: a node compares a feature that there is not (of {features})")
        if not np.isfinite(self.threshold[inner]).all():
            raise UsageError("trees: a threshold is not finite")
        node = np.arange(M)
        # One past the last node of the tree that each node belongs to
        end = np.append(self.root[1:], M)[np.searchsorted(self.root, node, side="right") - 1]
        for child in (self.left, self.right):
            is_behind = (child > node) & (child < end)
            if (inner & ~is_behind).any() or (~inner & (child != LEAF)).any():
                raise UsageError("trees: a node's child does not stand behind it in its tree")
        children = np.concatenate([self.left[inner], self.right[inner]])
        if (np.bincount(children, minlength=M) > 1).any():
            raise UsageError("trees: a node is the child of two")
        level = self.root
        for _ in range(MAX_DEPTH + 1):
            level = level[inner[level]]
            if not len(level):
                return
            level = np.concatenate([self.left[level], self.right[level]])
        raise UsageError(f"trees: a tree is deeper than {MAX_DEPTH}")


def join_trees(trees: list[Trees]) -> Trees:
    """Join trees one after the other."""
    shift = np.cumsum([0, *(len(t.feature) for t in trees)])[:-1]

    def shift_indices(index: IntArray, offset: int) -> IntArray:
        return np.where(index == LEAF, LEAF, index + offset)

    return Trees(
        root=np.concatenate([t.root + k for t, k in zip(trees, shift, strict=True)]),
        feature=np.concatenate([t.feature for t in trees]),
        threshold=np.concatenate([t.threshold for t in trees]),
        left=np.concatenate([shift_indices(t.left, k) for t, k in zip(trees, shift, strict=True)]),
        right=np.concatenate(
            [shift_indices(t.right, k) for t, k in zip(trees, shift, strict=True)]
        ),
    )
