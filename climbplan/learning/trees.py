"""Decision trees as plain arrays, all nodes of all trees one after the other.

A child always stands behind its one parent, so that no walk from a root can come round again, and
none is longer than the deepest trees that a spec may ask for: files from elsewhere are refused if
theirs are not so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError

LEAF = -1
DEEPEST = 1000  # a walk of a million steps would seem to hang


@dataclass(frozen=True)
class Trees:
    """T trees with M nodes together."""

    root: IntArray  # (T,) first node of each tree, increasing
    feature: IntArray  # (M,) compared at the node, LEAF at leaves
    threshold: Array  # (M,) go left where the feature is at most this
    left: IntArray  # (M,) LEAF at leaves
    right: IntArray  # (M,)

    def leaves(self, features: Array) -> IntArray:
        """The leaf (T,) that features (p,) end in, of each tree."""
        node = self.root.copy()
        while True:
            feature = self.feature[node]
            inner = feature >= 0
            if not inner.any():
                return node
            at = node[inner]
            low = features[feature[inner]] <= self.threshold[at]
            node[inner] = np.where(low, self.left[at], self.right[at])

    def require(self, features: int) -> None:
        """Raises UsageError unless these are trees over so many features."""
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
            behind = (child > node) & (child < end)
            if (inner & ~behind).any() or (~inner & (child != LEAF)).any():
                raise UsageError("trees: a node's child does not stand behind it in its tree")
        children = np.concatenate([self.left[inner], self.right[inner]])
        if (np.bincount(children, minlength=M) > 1).any():
            raise UsageError("trees: a node is the child of two")
        level = self.root
        for _ in range(DEEPEST + 1):
            level = level[inner[level]]
            if not len(level):
                return
            level = np.concatenate([self.left[level], self.right[level]])
        raise UsageError(f"trees: a tree is deeper than {DEEPEST}")


def joined(trees: list[Trees]) -> Trees:
    """Trees one behind the other."""
    shift = np.cumsum([0, *(len(t.feature) for t in trees)])[:-1]

    def moved(part: IntArray, by: int) -> IntArray:
        return np.where(part == LEAF, LEAF, part + by)

    return Trees(
        root=np.concatenate([t.root + k for t, k in zip(trees, shift, strict=True)]),
        feature=np.concatenate([t.feature for t in trees]),
        threshold=np.concatenate([t.threshold for t in trees]),
        left=np.concatenate([moved(t.left, k) for t, k in zip(trees, shift, strict=True)]),
        right=np.concatenate([moved(t.right, k) for t, k in zip(trees, shift, strict=True)]),
    )
