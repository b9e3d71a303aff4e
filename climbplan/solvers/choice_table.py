"""One choice as intervals: every alternative seen along all row directions of the choice.

Along a direction d an alternative takes values in [lower, upper]. The hull of a set of alternatives
is bounded by the least lower and the largest upper value of its members, so that a branch of the
search that allows only some alternatives changes nothing but bounds of the same rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from climbplan.program.polytope import Array, Polytope

UNBOUNDED = 1e30  # no bound, in DAQP's terms
_PARALLEL = 1e-9  # unit rows closer than this are the same direction
_OFF = 1e-6  # stated vertices further outside their own polytope are not trusted

Mask = int  # set of alternatives, one bit each


@dataclass(frozen=True)
class Splits:
    """Ways to divide a set of alternatives, the children of all ways one after another."""

    children: tuple[Mask, ...]
    first: NDArray[np.intp]  # (K,) where the children of each way start
    lower: Array  # (sum of children, D) hulls
    upper: Array


@dataclass(frozen=True)
class ChoiceTable:
    """Intervals of R alternatives along D directions."""

    directions: Array  # (D, d) unit rows
    lower: Array  # (R, D), -UNBOUNDED where nothing is known
    upper: Array  # (R, D)
    own_lower: Array  # (R, D) intervals by stated rows alone
    own_upper: Array
    bounded: bool  # vertices of all alternatives are known
    empty: NDArray[np.bool_]  # (R,) alternatives that are known to hold no point
    _hulls: dict[Mask, tuple[Array, Array]] = field(default_factory=dict, repr=False)
    _splits: dict[Mask, Splits] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, alternatives: tuple[Polytope, ...]) -> ChoiceTable:
        """The table of a choice among polytopes of one dimension d."""
        directions: list[Array] = []
        entries: list[tuple[int, int, float, float]] = []  # alternative, direction, lower, upper
        empty = np.zeros(len(alternatives), bool)
        for r, polytope in enumerate(alternatives):
            rows = [(a, -UNBOUNDED, float(b)) for a, b in zip(polytope.A, polytope.b, strict=True)]
            rows += [(a, float(c), float(c)) for a, c in zip(polytope.C, polytope.c, strict=True)]
            for a, low, high in rows:
                length = float(np.linalg.norm(a))
                if length < _PARALLEL:
                    if low > _PARALLEL or high < -_PARALLEL:
                        empty[r] = True
                    continue
                low = low / length if low > -UNBOUNDED else low
                index, sign = _direction(directions, a / length)
                low, high = (low, high / length) if sign > 0 else (-high / length, -low)
                entries.append((r, index, low, high))
        shape = (len(alternatives), len(directions))
        stacked = np.array(directions).reshape(shape[1], alternatives[0].dimension)
        lower, upper = np.full(shape, -UNBOUNDED), np.full(shape, UNBOUNDED)
        own_lower, own_upper = lower.copy(), upper.copy()
        bounded = True
        for r, polytope in enumerate(alternatives):
            if polytope.vertices is None or _outside(polytope) > _OFF:
                bounded = False
                continue
            along = polytope.vertices @ stacked.T
            lower[r], upper[r] = along.min(axis=0), along.max(axis=0)
        for r, index, low, high in entries:
            own_lower[r, index] = max(own_lower[r, index], low)
            own_upper[r, index] = min(own_upper[r, index], high)
        # A stated row is exact; what the vertices say on the other side of it still holds.
        lower, upper = np.maximum(lower, own_lower), np.minimum(upper, own_upper)
        empty |= (lower > upper + _OFF).any(axis=1)
        return cls(
            directions=stacked,
            lower=lower,
            upper=upper,
            own_lower=own_lower,
            own_upper=own_upper,
            bounded=bounded,
            empty=empty,
        )

    @property
    def count(self) -> int:
        """R."""
        return len(self.lower)

    def mask(self, allowed: NDArray[np.bool_]) -> Mask:
        """The set of the alternatives that are flagged, (R,) or longer."""
        return sum(1 << int(r) for r in np.flatnonzero(allowed))

    def members(self, mask: Mask) -> list[int]:
        """Indices of the alternatives in a set."""
        return [r for r in range(self.count) if mask >> r & 1]

    def hull(self, mask: Mask) -> tuple[Array, Array]:
        """Lower and upper bounds (D,) of the union of a set along every direction.

        A single alternative is bounded by its own rows alone: others would only repeat them.
        """
        if mask not in self._hulls:
            members = self.members(mask)
            if len(members) == 1:
                self._hulls[mask] = self.own_lower[members[0]], self.own_upper[members[0]]
            else:
                low, high = self.lower[members].min(axis=0), self.upper[members].max(axis=0)
                self._hulls[mask] = low, high
        return self._hulls[mask]

    def splits(self, mask: Mask) -> Splits:
        """Candidate ways to branch on a set of at least two alternatives.

        With known vertices: each alternative against the rest, and the sets below and above every
        threshold along every direction (of two disjoint polygons one edge separates them). Without
        vertices a hull says nothing, so each alternative becomes a child of its own.
        """
        if mask not in self._splits:
            members = self.members(mask)
            ways = self._halves(mask, members) if self.bounded else [[1 << r for r in members]]
            children = [child for way in ways for child in way]
            hulls = [self.hull(child) for child in children]
            self._splits[mask] = Splits(
                tuple(children),
                np.cumsum([0, *(len(way) for way in ways[:-1])]),
                np.array([low for low, _ in hulls]),
                np.array([high for _, high in hulls]),
            )
        return self._splits[mask]

    def _halves(self, mask: Mask, members: list[int]) -> list[list[Mask]]:
        halves: dict[frozenset[Mask], None] = {}
        for r in members:
            halves.setdefault(frozenset((1 << r, mask & ~(1 << r))))
        middle = self.lower[members] + self.upper[members]
        for order in np.argsort(middle, axis=0, kind="stable").T:
            below = 0
            for index in order[:-1]:
                below |= 1 << members[int(index)]
                halves.setdefault(frozenset((below, mask & ~below)))
        return [sorted(half) for half in halves]


def _direction(known: list[Array], row: Array) -> tuple[int, int]:
    """Index and sign of a unit row among known directions; it is added if it is new."""
    for index, direction in enumerate(known):
        if np.abs(direction - row).max() < _PARALLEL:
            return index, 1
        if np.abs(direction + row).max() < _PARALLEL:
            return index, -1
    known.append(row)
    return len(known) - 1, 1


def _outside(polytope: Polytope) -> float:
    assert polytope.vertices is not None
    return max((polytope.violation(v) for v in polytope.vertices), default=np.inf)
