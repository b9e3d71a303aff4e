"""What planning has tried, how it went, and how long it may go on.

A budget of work ends it: programs solved and courses of events begun, so that the same seed finds
the same plan on any machine. The clock is a cap, and a plan that it cut short says so.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from climbplan.errors import LimitReached
from climbplan.limms.attempts.answers import Outcome
from climbplan.limms.attempts.work import Work

T = TypeVar("T")


class Answered(Protocol):
    """What every answer of a program says of itself."""

    @property
    def work(self) -> Work: ...
    @property
    def variables(self) -> int: ...
    @property
    def constraints(self) -> int: ...
    @property
    def solved(self) -> bool: ...
    @property
    def message(self) -> str: ...


@dataclass
class Attempts:
    """What was tried and how it went, for the report and for messages."""

    limit: float  # [s] of the whole planning, from now on
    most: int  # programs and courses of events, together
    work: Work = field(default_factory=Work)
    begun: int = 0  # courses of events
    variables: int = 0
    constraints: int = 0
    notes: list[str] = field(default_factory=list)
    known: dict[Hashable, Outcome] = field(default_factory=dict)  # answers of programs of arms
    under_way: str = ""  # what is being tried
    end: float = field(init=False)  # `time.monotonic` [s]

    def __post_init__(self) -> None:
        self.end = time.monotonic() + self.limit

    @property
    def over(self) -> bool:
        """Whether the clock has passed the limit: an answer from now on may be what it cut off."""
        return time.monotonic() > self.end

    @property
    def spare(self) -> int:
        """What is left of the budget."""
        return self.left_of(self.most)

    def left_of(self, most: int) -> int:
        """What would be left if the budget were another one."""
        return most - self.work.programs - self.begun

    def begin(self, what: str) -> None:
        """From now on `what` is being tried, which counts as one program.

        Raises:
            LimitReached: there is no budget or time for it.
        """
        self.left()
        self.under_way = what
        self.begun += 1

    def left(self) -> None:
        """Go on only if there is budget and time left.

        Raises:
            LimitReached: there is none.
        """
        if self.spare > 0 and not self.over:
            return
        key = "`solver.programs`" if self.spare <= 0 else "`solver.time_limit`"
        ended = f"; {key} ended {self.under_way}" if self.under_way else ""
        raise LimitReached(f"no plan found {self.bounds()}. {self.story()}{ended}", stage="motion")

    def bounds(self) -> str:
        """What ended the search, in words."""
        if self.spare <= 0:
            return f"with {self.most} programs and courses of events"
        return f"within {self.limit:g} s"

    def choices(self, choices: Iterable[T], what: str) -> Iterator[T]:
        """Choices of branches for `what` one by one.

        Raises:
            LimitReached: budget or time of the whole planning are over.
        """
        for number, choice in enumerate(choices):
            self.begin(f"{what}, choice {number + 1} of branches")
            yield choice

    def part(self, most: int) -> Attempts:
        """The budget of a part of the planning, with the same end; `add` what it took."""
        part = Attempts(self.limit, min(most, self.spare))
        part.end, part.known = self.end, self.known
        return part

    def add(self, part: Attempts) -> None:
        """What a part of the planning took and told."""
        self.work += part.work
        self.begun += part.begun
        self.notes += part.notes
        self.variables = part.variables or self.variables
        self.constraints = part.constraints or self.constraints

    def story(self) -> str:
        """What was tried, in words."""
        tried = "; ".join(note for note in dict.fromkeys(self.notes) if note)
        programs = f" ({self.work.programs} programs, {self.work.seconds:.1f} s)"
        story = f"Tried: {tried}" if tried else "Nothing was tried to its end"
        return story + (programs if self.work.programs else "")

    def count(self, outcome: Answered, what: str) -> None:
        """Programs that were solved for one answer."""
        self.work += outcome.work
        self.variables, self.constraints = outcome.variables, outcome.constraints
        if not outcome.solved:
            self.notes.append(f"{what}: {outcome.message}")
