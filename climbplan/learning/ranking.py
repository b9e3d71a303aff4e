"""Strategies in the order that a classifier ranks them, each from its nearest solved problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.strategy import Candidate, build_candidate


class Scorer(Protocol):
    """A classifier that was trained: forest, network or boosted trees."""

    def probabilities(self, features: Array) -> Array:
        """Return the probability of each class at features (p,); they sum to 1."""


@dataclass(frozen=True)
class RankedStrategies:
    """Strategies of a library by probability; equal ones (mostly zero) by distance."""

    library: Library
    scorer: Scorer
    scale: Array  # (p,) of the features in distances

    def candidates(self, features: Array, max_count: int) -> list[Candidate]:
        """Return the most probable strategies, each from the point of its nearest problem."""
        query = check_features(features, self.library)
        difference = (self.library.features - query) / self.scale
        distance = np.einsum("sp,sp->s", difference, difference)
        by_distance = np.argsort(distance, kind="stable")
        _, nearest = np.unique(self.library.strategy[by_distance], return_index=True)
        rows = by_distance[nearest]  # (U,) nearest problem of each strategy
        probability = self.scorer.probabilities(query)
        order = np.lexsort((distance[rows], -probability))[:max_count]
        return [build_candidate(self.library, int(rows[u]), -float(probability[u])) for u in order]


def check_features(features: Array, library: Library) -> Array:
    """Return the features (p,) of a new problem.

    Raises:
        UsageError: They do not fit the library.
    """
    query = np.asarray(features, float)
    if query.shape != library.features.shape[1:] or not np.isfinite(query).all():
        raise UsageError(
            f"{library.features.shape[1]} finite features expected, got shape {query.shape}"
        )
    return query
