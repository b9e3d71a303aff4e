"""What was tried, and how much time is left."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from climbplan.errors import LimitReached
from climbplan.limms.answers import Outcome
from climbplan.limms.leg_solver import LegOutcome


@dataclass
class Attempts:
    """What was tried and how it went, for the report and for messages."""

    limit: float  # [s] of the whole planning, from now on
    programs: int = 0
    solver_seconds: float = 0.0
    build_seconds: float = 0.0
    variables: int = 0
    constraints: int = 0
    notes: list[str] = field(default_factory=list)
    end: float = field(init=False)  # `time.monotonic` [s]

    def __post_init__(self) -> None:
        self.end = time.monotonic() + self.limit

    def left(self, most: float = np.inf) -> float:
        """Seconds left for what comes next, `most` at most.

        Raises:
            LimitReached: none are left.
        """
        seconds = self.end - time.monotonic()
        if seconds <= 0:
            raise LimitReached(f"no plan found within {self.limit:g} s. {self.story()}")
        return min(seconds, most)

    def story(self) -> str:
        """What was tried, in words."""
        tried = "; ".join(dict.fromkeys(self.notes))
        return f"Tried: {tried}" if tried else "Nothing was tried to its end"

    def count(self, outcome: Outcome | LegOutcome, what: str) -> None:
        """One more program."""
        self.programs += 1
        self.solver_seconds += outcome.seconds
        self.build_seconds += outcome.build_seconds
        self.variables, self.constraints = outcome.variables, outcome.constraints
        if not outcome.solved:
            self.notes.append(f"{what}: {outcome.message}")
