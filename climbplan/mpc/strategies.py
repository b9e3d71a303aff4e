"""Which stored sections a situation calls for, best first."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from climbplan.mpc.library import Library
from climbplan.mpc.task import Array, Whole


class Ranking(Protocol):
    """Ranks the sections of a library for a situation."""

    def ranked(self, features: Array, count: int) -> Whole:
        """Indices of at most `count` sections, best first; features (F,)."""
        ...


class Neighbours:
    """The k nearest, by the distance of features."""

    def __init__(self, library: Library) -> None:
        self._features = library.features
        self._half_norm = 0.5 * (library.features**2).sum(axis=1)

    def ranked(self, features: Array, count: int) -> Whole:
        """Indices of the nearest sections, nearest first."""
        # Half the squared distance, without what is the same for all
        apart = self._half_norm - self._features @ features
        count = min(count, len(apart))
        found = np.argpartition(apart, count - 1)[:count] if count else np.zeros(0, np.int64)
        nearest: Whole = found[np.argsort(apart[found])]
        return nearest
