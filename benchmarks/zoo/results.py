"""A cell of the table of `zoo`, and the file that keeps all cells."""

from __future__ import annotations

from dataclasses import dataclass

FILE = "results.csv"


@dataclass(frozen=True)
class Row:
    """One cell of the table."""

    robot: str
    mass: float  # [kg]; 0 where nothing is proposed
    legs: int
    proposed: float  # [s] CPU of the proposal, with the walk on ground that settles how it stands
    column: str
    planned: bool  # and verified
    simulated: str
    words: str
    cpu: float  # [s]
