"""k nearest neighbours, as published and on solved problems themselves.

Published: each strategy is the centroid of the features of the problems that it solved, distances
on raw features. Ours: distances to the problems on standardised features, so that millimetres do
not outweigh radians, and their points as starts. Equal distances are ordered by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.ranking import checked_features
from climbplan.learning.strategy import Candidate, candidate_of

Order = Literal["points", "strategies", "mixed"]


def _standard_deviation(features: Array) -> Array:
    deviation = features.std(axis=0)
    # A constant feature tells nothing, but a new problem that differs in it is farther away.
    return np.where(deviation > 1e-12, deviation, 1.0)


@dataclass(frozen=True)
class NearestProblems:
    """The solved problems nearest to a new one.

    order: `points` in order of distance, the same integers from several starts; `strategies` only
    the nearest of each strategy; `mixed` the nearest of each strategy first, then further starts.
    """

    library: Library
    scale: Array  # (p,)
    order: Order = "points"

    @classmethod
    def of(cls, library: Library, order: Order = "points") -> NearestProblems:
        """Raises UsageError for a library without problems."""
        if not library.size:
            raise UsageError("nearest neighbours need a library with at least one solved problem")
        return cls(library, _standard_deviation(library.features), order)

    def candidates(self, features: Array, most: int) -> list[Candidate]:
        """Nearest first."""
        wanted = checked_features(features, self.library)
        apart = (self.library.features - wanted) / self.scale
        distance = np.sqrt(np.einsum("sp,sp->s", apart, apart))
        near: IntArray = np.argsort(distance, kind="stable")
        if self.order != "points":
            _, first = np.unique(self.library.strategy[near], return_index=True)
            leading = np.sort(first)[:most]
            rest = np.setdiff1d(np.arange(min(len(near), 2 * most)), leading)
            places = leading if self.order == "strategies" else np.concatenate([leading, rest])
            near = near[places]
        return [candidate_of(self.library, int(s), float(distance[s])) for s in near[:most]]


@dataclass(frozen=True)
class NearestCentroids:
    """The published rule: strategies by the distance of their centroid of raw features."""

    library: Library
    centroid: Array  # (U, p)

    @classmethod
    def of(cls, library: Library) -> NearestCentroids:
        """Raises UsageError for a library without problems."""
        if not library.size:
            raise UsageError("nearest neighbours need a library with at least one solved problem")
        count = np.bincount(library.strategy)
        total = np.zeros((len(count), library.features.shape[1]))
        np.add.at(total, library.strategy, library.features)
        return cls(library, total / count[:, None])

    def candidates(self, features: Array, most: int) -> list[Candidate]:
        """Each strategy once, from the point of its problem that is nearest."""
        wanted = checked_features(features, self.library)
        distance = np.linalg.norm(self.centroid - wanted, axis=1)
        own = np.linalg.norm(self.library.features - wanted, axis=1)
        out = []
        for u in np.argsort(distance, kind="stable")[:most]:
            row = int(np.argmin(np.where(self.library.strategy == u, own, np.inf)))
            out.append(candidate_of(self.library, row, float(distance[u])))
        return out
