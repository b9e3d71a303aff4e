"""What planning has tried, how it went, and how long it may go on."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from climbplan.errors import LimitReached
from climbplan.limms.arms.answers import Outcome
from climbplan.limms.legs.solver import LegOutcome

T = TypeVar("T")


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
    under_way: str = ""  # what is being tried
    end: float = field(init=False)  # `time.monotonic` [s]

    def __post_init__(self) -> None:
        self.end = time.monotonic() + self.limit

    def begin(self, what: str) -> None:
        """From now on `what` is being tried.

        Raises:
            LimitReached: there is no time for it.
        """
        self.left()
        self.under_way = what

    def left(self, most: float = np.inf) -> float:
        """Seconds left for what comes next, `most` at most.

        Raises:
            LimitReached: none are left.
        """
        seconds = self.end - time.monotonic()
        if seconds <= 0:
            ended = f"; `solver.time_limit` ended {self.under_way}" if self.under_way else ""
            raise LimitReached(
                f"no plan found within {self.limit:g} s. {self.story()}{ended}", stage="motion"
            )
        return min(seconds, most)

    def until(self, deadline: float) -> float:
        """A deadline by `time.monotonic`, the whole planning's if that is earlier."""
        return min(deadline, self.end)

    def in_time(self, choices: Iterable[T], what: str, deadline: float) -> Iterator[T]:
        """Choices of `what` one by one, as long as there is time.

        Raises:
            LimitReached: the whole planning's time is over.
        """
        for number, choice in enumerate(choices):
            self.begin(f"{what}, choice {number + 1} of branches")
            if time.monotonic() > deadline:
                self.notes.append(f"{what}: {number} choices of branches, then its time was over")
                return
            yield choice

    def story(self) -> str:
        """What was tried, in words."""
        tried = "; ".join(note for note in dict.fromkeys(self.notes) if note)
        programs = f" ({self.programs} programs, {self.solver_seconds:.1f} s)"
        story = f"Tried: {tried}" if tried else "Nothing was tried to its end"
        return story + (programs if self.programs else "")

    def count(self, outcome: Outcome | LegOutcome, what: str) -> None:
        """One more program."""
        self.programs += 1
        self.solver_seconds += outcome.seconds
        self.build_seconds += outcome.build_seconds
        self.variables, self.constraints = outcome.variables, outcome.constraints
        if not outcome.solved:
            self.notes.append(f"{what}: {outcome.message}")
