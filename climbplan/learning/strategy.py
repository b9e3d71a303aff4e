"""Interface of learned strategies: features of a problem -> candidates, best first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from climbplan.arrays import Array, IntArray
from climbplan.learning.library import Library


@dataclass(frozen=True)
class Candidate:
    """Integers to try, and a start."""

    values: Array  # (N,) point of which only the binaries are read
    alternatives: IntArray  # (C,)
    start: Array  # (N,)
    number: int = -1  # strategy in the library from which it comes
    row: int = -1  # solved problem whose point is the start
    score: float = 0.0  # distance, negative probability, or cost: smaller is better


class Strategy(Protocol):
    """Interface of nearest neighbours, forests, networks and clusters."""

    def candidates(self, features: Array, max_count: int) -> list[Candidate]:
        """Return at most `most` candidates for a problem with features (p,), best first."""


def build_candidate(library: Library, row: int, score: float) -> Candidate:
    """Build the candidate with the integers and the point of one solved problem."""
    return Candidate(
        values=library.points[row],
        alternatives=library.alternatives[row],
        start=library.points[row],
        number=int(library.strategy[row]),
        row=row,
        score=score,
    )
