"""The one interface of learned strategies: features of a problem -> candidates, best first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from climbplan.arrays import Array, IntArray
from climbplan.learning.library import Library


@dataclass(frozen=True)
class Candidate:
    """Integers to try, and where to start from."""

    values: Array  # (N,) of which only the binaries are read
    alternatives: IntArray  # (C,)
    start: Array  # (N,)
    number: int = -1  # of the strategy in the library it comes from
    row: int = -1  # of the solved problem whose point is the start
    score: float = 0.0  # distance, minus probability, cost: less is better


class Strategy(Protocol):
    """What nearest neighbours, forests, networks and clusters offer."""

    def candidates(self, features: Array, most: int) -> list[Candidate]:
        """At most `most` candidates for a problem with the given features (p,), best first."""


def candidate_of(library: Library, row: int, score: float) -> Candidate:
    """The integers and the point of one solved problem."""
    return Candidate(
        values=library.points[row],
        alternatives=library.alternatives[row],
        start=library.points[row],
        number=int(library.strategy[row]),
        row=row,
        score=score,
    )
