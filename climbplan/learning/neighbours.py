"""k nearest neighbours, as published and on solved problems themselves.

In the published method each strategy is the centroid of the features of its problems, with
distances on raw features. Here distances are to the problems on standardised features, so that
millimetres do not outweigh radians, and their points are starts. Equal distances are ordered by
row.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.ranking import check_features
from climbplan.learning.strategy import Candidate, build_candidate

Order = Literal["points", "strategies", "mixed"]


def _compute_scale(features: Array) -> Array:
    """Return the standard deviation of features."""
    deviation = features.std(axis=0)
    # A constant feature has scale 1: a new problem that differs in it is farther away.
    return np.where(deviation > 1e-12, deviation, 1.0)


@dataclass(frozen=True)
class NearestProblems:
    """The solved problems nearest to a new one.

    Order `points` is by distance, with the same integers from several starts; `strategies` is the
    nearest of each strategy only; `mixed` is the nearest of each strategy first, then further
    starts.
    """

    library: Library
    scale: Array  # (p,)
    order: Order = "points"

    @classmethod
    def of(cls, library: Library, order: Order = "points") -> NearestProblems:
        """Build from a library.

        Raises:
            UsageError: The library is empty.
        """
        if not library.size:
            raise UsageError("nearest neighbours need a library with at least one solved problem")
        return cls(library, _compute_scale(library.features), order)

    def candidates(self, features: Array, max_count: int) -> list[Candidate]:
        """Return candidates, nearest first."""
        query = check_features(features, self.library)
        difference = (self.library.features - query) / self.scale
        distance = np.sqrt(np.einsum("sp,sp->s", difference, difference))
        by_distance: IntArray = np.argsort(distance, kind="stable")
        if self.order != "points":
            _, first = np.unique(self.library.strategy[by_distance], return_index=True)
            leading = np.sort(first)[:max_count]
            further = np.setdiff1d(np.arange(min(len(by_distance), 2 * max_count)), leading)
            selected = leading if self.order == "strategies" else np.concatenate([leading, further])
            by_distance = by_distance[selected]
        return [
            build_candidate(self.library, int(s), float(distance[s]))
            for s in by_distance[:max_count]
        ]


@dataclass(frozen=True)
class NearestCentroids:
    """X. Lin (UCLA 2022): strategies by the distance of their centroid of raw features."""

    library: Library
    centroid: Array  # (U, p)

    @classmethod
    def of(cls, library: Library) -> NearestCentroids:
        """Build from a library.

        Raises:
            UsageError: The library is empty.
        """
        if not library.size:
            raise UsageError("nearest neighbours need a library with at least one solved problem")
        count = np.bincount(library.strategy)
        total = np.zeros((len(count), library.features.shape[1]))
        np.add.at(total, library.strategy, library.features)
        return cls(library, total / count[:, None])

    def candidates(self, features: Array, max_count: int) -> list[Candidate]:
        """Return each strategy once, from its nearest problem's point."""
        query = check_features(features, self.library)
        distance = np.linalg.norm(self.centroid - query, axis=1)
        problem_distance = np.linalg.norm(self.library.features - query, axis=1)
        candidates = []
        for u in np.argsort(distance, kind="stable")[:max_count]:
            row = int(np.argmin(np.where(self.library.strategy == u, problem_distance, np.inf)))
            candidates.append(build_candidate(self.library, row, float(distance[u])))
        return candidates
