"""Clusters of solved problems ranked by a classifier, and their strategies, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.library import Library
from climbplan.learning.ranking import Scorer, checked_features
from climbplan.learning.strategy import Candidate, candidate_of


@dataclass(frozen=True)
class ClusterRanking:
    """Which cluster each solved problem is in, and how probable each is for a new one."""

    library: Library
    cluster: IntArray  # (S,) negative: in none
    scorer: Scorer
    scale: Array  # (p,) of the features in distances

    @property
    def count(self) -> int:
        """Clusters."""
        return int(self.cluster.max()) + 1

    def members(self, cluster: int) -> IntArray:
        """Rows of the library in a cluster."""
        return np.flatnonzero(self.cluster == cluster)

    def ranked(self, features: Array, most: int) -> IntArray:
        """The likeliest clusters, first the most probable."""
        wanted = checked_features(features, self.library)
        probability = self.scorer.probabilities(wanted)
        return np.argsort(-probability, kind="stable")[:most]

    def candidates(self, features: Array, most: int) -> list[Candidate]:
        """Without solving anything: the strategies of the likeliest clusters, nearest first."""
        found: list[Candidate] = []
        seen: set[int] = set()
        for cluster in self.ranked(features, self.count):
            for row in self.strategies(features, int(cluster)):
                number = int(self.library.strategy[row])
                if number not in seen:
                    seen.add(number)
                    found.append(candidate_of(self.library, int(row), float(len(found))))
                if len(found) >= most:
                    return found
        return found

    def strategies(self, features: Array, cluster: int) -> IntArray:
        """The cluster's nearest row of each of its strategies, nearest first."""
        rows = self._near(features, self.members(cluster))
        _, first = np.unique(self.library.strategy[rows], return_index=True)
        return np.asarray(rows[np.sort(first)])

    def alike(
        self, features: Array, cluster: int, values: Array, alternatives: IntArray
    ) -> IntArray:
        """The cluster's rows with these integers, nearest first."""
        rows = self.members(cluster)
        integer = self.library.frame.integer
        same = (self.library.points[rows][:, integer] == np.round(values[integer])).all(axis=1)
        same &= (self.library.alternatives[rows] == alternatives).all(axis=1)
        return self._near(features, rows[same])

    def _near(self, features: Array, rows: IntArray) -> IntArray:
        apart = (self.library.features[rows] - features) / self.scale
        order = np.argsort(np.einsum("sp,sp->s", apart, apart), kind="stable")
        return np.asarray(rows[order])
