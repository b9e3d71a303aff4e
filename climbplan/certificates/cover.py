"""Whether leaves cover all integers and alternatives, by splitting what is to be covered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from climbplan.program.instance import Index

_MOST_PARTS = 10_000_000  # leaves of a tree need few more parts than there are leaves


@dataclass(frozen=True)
class Part:
    """Ranges of integers and alternatives of choices."""

    low: Index  # (I,)
    high: Index
    allowed: NDArray[np.bool_]  # (R,)


@dataclass(frozen=True)
class Leaves:
    """Many parts at once."""

    low: Index  # (S, I)
    high: Index
    allowed: NDArray[np.bool_]  # (S, R)
    choice: Index  # (R,)

    def meeting(self, part: Part, among: Index) -> Index:
        """Which of some leaves share a point with a part."""
        ranges = (self.low[among] <= part.high) & (self.high[among] >= part.low)
        kept = ranges.all(axis=1)
        common = self.allowed[among] & part.allowed
        for group in self.groups:
            kept &= common[:, group].any(axis=1)
        return among[kept]

    def holding(self, part: Part, among: Index) -> NDArray[np.bool_]:
        """Which of some leaves hold a whole part."""
        inside = (self.low[among] <= part.low) & (self.high[among] >= part.high)
        return np.asarray(inside.all(axis=1) & (self.allowed[among] | ~part.allowed).all(axis=1))

    @property
    def groups(self) -> list[Index]:
        """The alternatives of each choice."""
        return [np.flatnonzero(self.choice == k) for k in np.unique(self.choice)]


def uncovered(target: Part, leaves: Leaves) -> Part | None:
    """A part of the target that no leaf meets, None if there is none.

    Raises RuntimeError where the leaves overlap so much that splitting comes to no end.
    """
    stack = [(target, np.arange(len(leaves.low)))]
    for _ in range(_MOST_PARTS):
        if not stack:
            return None
        part, among = stack.pop()
        among = leaves.meeting(part, among)
        if not len(among):
            return part
        if leaves.holding(part, among).any():
            continue
        stack += [(side, among) for side in _sides(part, leaves, among)]
    raise RuntimeError("leaves overlap too much to be compared")


def _sides(part: Part, leaves: Leaves, among: Index) -> tuple[Part, Part]:
    """Two halves of a part, split where the fewest leaves reach over both sides."""
    low = np.maximum(leaves.low[among], part.low)
    high = np.minimum(leaves.high[among], part.high)
    best, sides = np.inf, None
    cut = _first(low - 1, low > part.low, _first(high, high < part.high, part.high))
    crossing = ((low <= cut) & (high > cut)).sum(axis=0)
    split = np.flatnonzero((cut >= part.low) & (cut < part.high))
    if len(split):
        i = split[np.argmin(crossing[split])]
        best = crossing[i]
        below, above = part.high.copy(), part.low.copy()
        below[i], above[i] = cut[i], cut[i] + 1
        sides = replace(part, high=below), replace(part, low=above)
    for group in leaves.groups:
        here = leaves.allowed[among][:, group] & part.allowed[group]
        partial = np.flatnonzero(here.sum(axis=1) < part.allowed[group].sum())
        if not len(partial):
            continue
        chosen = here[partial[0]]
        over = int((here[:, chosen].any(axis=1) & here[:, ~chosen].any(axis=1)).sum())
        if over < best:
            one, other = part.allowed.copy(), part.allowed.copy()
            one[group], other[group] = chosen, part.allowed[group] & ~chosen
            best, sides = over, (replace(part, allowed=one), replace(part, allowed=other))
    if sides is None:
        raise RuntimeError("a leaf that does not hold a part must split it")
    return sides


def _first(value: Index, where: NDArray[np.bool_], otherwise: Index) -> Index:
    """(I,) the value of the first leaf for which something holds."""
    at = where.argmax(axis=0)
    columns = np.arange(value.shape[1])
    return np.where(where[at, columns], value[at, columns], otherwise)
