"""Solved problems as candidates of integers for a new one.

A library is what an earlier run left: parameters, solutions, alternatives. Its rows nearest to a
new problem's features give the integers to try.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.errors import UsageError
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array


@dataclass(frozen=True)
class Candidate:
    """A point whose integers and alternatives are to be tried, and where it comes from."""

    x: Array  # (N,)
    assignment: Index  # (C,) chosen alternative of each choice
    origin: str  # as reports say it: "neighbour 3 (row 17)"

    def integers(self, instance: Instance) -> bytes:
        """The integers and alternatives as a key: equal keys are the same pinned program."""
        whole = np.round(self.x[instance.integer]).astype(np.int64)
        return np.concatenate([whole, np.asarray(self.assignment, np.int64)]).tobytes()


@dataclass(frozen=True)
class SolvedLibrary:
    """Features and solutions of solved problems."""

    features: Array  # (n, d)
    x: Array  # (n, N)
    assignment: Index  # (n, C)

    def __post_init__(self) -> None:
        n = len(self.features)
        if self.features.ndim != 2 or not n:
            raise UsageError("a library needs at least one solved problem")
        if len(self.x) != n or len(self.assignment) != n:
            raise UsageError("a library needs as many solutions as features")

    def nearest(self, features: Array, count: int | None = None) -> tuple[Candidate, ...]:
        """The rows nearest to the features (d,), each in units of its spread; all if not told."""
        spread = self.features.std(axis=0)
        gone = (self.features - features) / np.where(spread > 0, spread, 1.0)
        distance = np.linalg.norm(gone, axis=1)
        order = np.argsort(distance, kind="stable")[:count]
        return tuple(
            Candidate(self.x[row], self.assignment[row], f"neighbour {rank} (row {row})")
            for rank, row in enumerate(order, 1)
        )


def distinct(candidates: Sequence[Candidate], instance: Instance) -> tuple[Candidate, ...]:
    """The candidates in their order, without those that repeat an earlier one's integers."""
    first: dict[bytes, Candidate] = {}
    for candidate in candidates:
        first.setdefault(candidate.integers(instance), candidate)
    return tuple(first.values())
