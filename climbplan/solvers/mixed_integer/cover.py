"""Leaves of a search as a tree of splits of all its entities, which certificates are written in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import BoolArray, IntArray


class Part(NamedTuple):
    """Ranges of entities, and the leaves that may meet them."""

    low: IntArray  # (E,)
    high: IntArray
    among: IntArray


class Split(NamedTuple):
    """Where a part is split: `value` is the last one of the lower side."""

    entity: int
    value: int
    below: Part
    above: Part


class Leaves(NamedTuple):
    """Ranges of entities, leaf by leaf."""

    low: IntArray  # (S, E)
    high: IntArray

    def meeting(self, part: Part) -> Part:
        """The same part, among those leaves only that share a point with it."""
        low, high = self.low[part.among], self.high[part.among]
        return part._replace(
            among=part.among[((low <= part.high) & (high >= part.low)).all(axis=1)]
        )

    def holding(self, part: Part) -> int:
        """A leaf that holds a whole part, -1 if none does."""
        low, high = self.low[part.among], self.high[part.among]
        inside = np.flatnonzero(((low <= part.low) & (high >= part.high)).all(axis=1))
        return int(part.among[inside[0]]) if len(inside) else -1

    def split(self, part: Part) -> Split:
        """Two halves of a part that no leaf holds, where the fewest leaves reach over both."""
        low = np.maximum(self.low[part.among], part.low)
        high = np.minimum(self.high[part.among], part.high)
        cut = _first(low - 1, low > part.low, _first(high, high < part.high, part.high))
        crossing = ((low <= cut) & (high > cut)).sum(axis=0)
        possible = np.flatnonzero((cut >= part.low) & (cut < part.high))
        e = int(possible[np.argmin(crossing[possible])])
        below, above = part.high.copy(), part.low.copy()
        below[e], above[e] = cut[e], cut[e] + 1
        return Split(e, int(cut[e]), part._replace(high=below), part._replace(low=above))


def _first(value: IntArray, where: BoolArray, otherwise: IntArray) -> IntArray:
    """(E,) the value of the first leaf for which something holds."""
    at = where.argmax(axis=0)
    columns = np.arange(value.shape[1])
    return np.where(where[at, columns], value[at, columns], otherwise)
