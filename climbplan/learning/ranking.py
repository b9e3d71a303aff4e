"""Strategies in the order that a classifier ranks them, each from its nearest solved problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.strategy import Candidate, candidate_of


class Scorer(Protocol):
    """A classifier that was trained: forest, network or boosted trees."""

    def probabilities(self, features: Array) -> Array:
        """How probable each class is at features (p,); sums to 1."""


@dataclass(frozen=True)
class RankedStrategies:
    """Strategies of a library by probability; where it is equal (zero, mostly) by distance."""

    library: Library
    scorer: Scorer
    scale: Array  # (p,) of the features in distances

    def candidates(self, features: Array, most: int) -> list[Candidate]:
        """Most probable first, each from the point of its nearest problem."""
        wanted = checked_features(features, self.library)
        apart = (self.library.features - wanted) / self.scale
        distance = np.einsum("sp,sp->s", apart, apart)
        near = np.argsort(distance, kind="stable")
        _, first = np.unique(self.library.strategy[near], return_index=True)
        rows = near[first]  # (U,) nearest problem of each strategy
        probability = self.scorer.probabilities(wanted)
        order = np.lexsort((distance[rows], -probability))[:most]
        return [candidate_of(self.library, int(rows[u]), -float(probability[u])) for u in order]


def checked_features(features: Array, library: Library) -> Array:
    """The features (p,) of a new problem; raises UsageError if they do not fit the library."""
    given = np.asarray(features, float)
    if given.shape != library.features.shape[1:] or not np.isfinite(given).all():
        raise UsageError(
            f"{library.features.shape[1]} finite features expected, got shape {given.shape}"
        )
    return given
