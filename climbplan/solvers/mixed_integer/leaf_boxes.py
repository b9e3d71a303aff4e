"""Arrange the leaves of a search as a tree of splits, as certificates store them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import BoolArray, IntArray


class Subdomain(NamedTuple):
    """Ranges of all entities, and the leaves that may intersect them."""

    low: IntArray  # (E,)
    high: IntArray
    among: IntArray


class SubdomainSplit(NamedTuple):
    """A subdomain split in two; `value` is the last one of the lower side."""

    entity: int
    value: int
    below: Subdomain
    above: Subdomain


class LeafBoxes(NamedTuple):
    """Ranges of entities of each leaf."""

    low: IntArray  # (S, E)
    high: IntArray

    def restrict_to_intersecting(self, subdomain: Subdomain) -> Subdomain:
        """Return the same subdomain with only those leaves that intersect it."""
        low, high = self.low[subdomain.among], self.high[subdomain.among]
        return subdomain._replace(
            among=subdomain.among[((low <= subdomain.high) & (high >= subdomain.low)).all(axis=1)]
        )

    def find_covering_leaf(self, subdomain: Subdomain) -> int:
        """Return a leaf that covers the whole subdomain, or -1."""
        low, high = self.low[subdomain.among], self.high[subdomain.among]
        inside = np.flatnonzero(((low <= subdomain.low) & (high >= subdomain.high)).all(axis=1))
        return int(subdomain.among[inside[0]]) if len(inside) else -1

    def split(self, subdomain: Subdomain) -> SubdomainSplit:
        """Split a subdomain that no leaf covers where the fewest leaves extend over both sides."""
        low = np.maximum(self.low[subdomain.among], subdomain.low)
        high = np.minimum(self.high[subdomain.among], subdomain.high)
        cut = _select_first(
            low - 1, low > subdomain.low, _select_first(high, high < subdomain.high, subdomain.high)
        )
        crossing = ((low <= cut) & (high > cut)).sum(axis=0)
        possible = np.flatnonzero((cut >= subdomain.low) & (cut < subdomain.high))
        e = int(possible[np.argmin(crossing[possible])])
        below, above = subdomain.high.copy(), subdomain.low.copy()
        below[e], above[e] = cut[e], cut[e] + 1
        return SubdomainSplit(
            e, int(cut[e]), subdomain._replace(high=below), subdomain._replace(low=above)
        )


def _select_first(value: IntArray, where: BoolArray, otherwise: IntArray) -> IntArray:
    """Return (E,) the value of the first leaf that satisfies a condition, else `otherwise`."""
    leaf = where.argmax(axis=0)
    columns = np.arange(value.shape[1])
    return np.where(where[leaf, columns], value[leaf, columns], otherwise)
