"""Rank clusters of solved problems by a classifier, and their strategies by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.library import Library
from climbplan.learning.ranking import Scorer, check_features
from climbplan.learning.strategy import Candidate, build_candidate


@dataclass(frozen=True)
class ClusterRanking:
    """The cluster of each solved problem, and a classifier of clusters for a new one."""

    library: Library
    cluster: IntArray  # (S,) negative for none
    scorer: Scorer
    scale: Array  # (p,) of the features in distances

    @property
    def count(self) -> int:
        """Number of clusters."""
        return int(self.cluster.max()) + 1

    def list_members(self, cluster: int) -> IntArray:
        """Return the rows of the library in a cluster."""
        return np.flatnonzero(self.cluster == cluster)

    def rank(self, features: Array, max_clusters: int) -> IntArray:
        """Return the likeliest clusters, the most probable first."""
        query = check_features(features, self.library)
        probability = self.scorer.probabilities(query)
        return np.argsort(-probability, kind="stable")[:max_clusters]

    def candidates(self, features: Array, max_count: int) -> list[Candidate]:
        """Return the strategies of the likeliest clusters, nearest first, without programs."""
        candidates: list[Candidate] = []
        strategies: set[int] = set()
        for cluster in self.rank(features, self.count):
            for row in self.list_strategies(features, int(cluster)):
                number = int(self.library.strategy[row])
                if number not in strategies:
                    strategies.add(number)
                    candidates.append(
                        build_candidate(self.library, int(row), float(len(candidates)))
                    )
                if len(candidates) >= max_count:
                    return candidates
        return candidates

    def list_strategies(self, features: Array, cluster: int) -> IntArray:
        """Return the cluster's nearest row of each of its strategies, nearest first."""
        rows = self._sort_by_distance(features, self.list_members(cluster))
        _, first = np.unique(self.library.strategy[rows], return_index=True)
        return np.asarray(rows[np.sort(first)])

    def find_equal_integers(
        self, features: Array, cluster: int, values: Array, alternatives: IntArray
    ) -> IntArray:
        """Return the cluster's rows with these integers, nearest first."""
        rows = self.list_members(cluster)
        integer = self.library.frame.integer
        same = (self.library.points[rows][:, integer] == np.round(values[integer])).all(axis=1)
        same &= (self.library.alternatives[rows] == alternatives).all(axis=1)
        return self._sort_by_distance(features, rows[same])

    def _sort_by_distance(self, features: Array, rows: IntArray) -> IntArray:
        """Sort rows by the distance of their features."""
        difference = (self.library.features[rows] - features) / self.scale
        order = np.argsort(np.einsum("sp,sp->s", difference, difference), kind="stable")
        return np.asarray(rows[order])
