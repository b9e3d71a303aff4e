"""The budget of planning: work, time, and notes on failed attempts.

The budget counts programs solved and sequences of events begun, so that the same seed finds the
same plan on any machine. The clock is only a cap, and a plan that it cut short says so.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from climbplan.errors import LimitReached
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.solver_work import Work

T = TypeVar("T")


class ProgramAnswer(Protocol):
    """The properties that every answer of a program has."""

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
class SearchBudget:
    """The budget of a search, its use so far, and notes for the report and for messages."""

    time_limit: float  # [s] for the whole planning, from construction
    max_programs: int  # programs and sequences of events together
    work: Work = field(default_factory=Work)
    num_sequences: int = 0  # sequences of events
    variables: int = 0
    constraints: int = 0
    notes: list[str] = field(default_factory=list)
    cached_outcomes: dict[Hashable, ProgramOutcome] = field(
        default_factory=dict
    )  # by program of arms
    activity: str = ""  # the current attempt, for messages
    deadline: float = field(init=False)  # as `time.monotonic` [s]

    def __post_init__(self) -> None:
        self.deadline = time.monotonic() + self.time_limit

    @property
    def is_expired(self) -> bool:
        """True if the clock has passed the limit; later answers may be cut short."""
        return time.monotonic() > self.deadline

    @property
    def remaining(self) -> int:
        """The number of programs and sequences left."""
        return self.compute_remaining(self.max_programs)

    def compute_remaining(self, max_programs: int) -> int:
        """Return what would be left of another maximum."""
        return max_programs - self.work.programs - self.num_sequences

    def begin(self, label: str) -> None:
        """Record the start of an attempt, which counts as one program.

        Args:
            label: The attempt, for messages.

        Raises:
            LimitReached: No budget or time is left.
        """
        self.require_remaining()
        self.activity = label
        self.num_sequences += 1

    def require_remaining(self) -> None:
        """Raise an error unless budget and time are left.

        Raises:
            LimitReached: Nothing is left.
        """
        if self.remaining > 0 and not self.is_expired:
            return
        key = "`solver.max_nlp_solves`" if self.remaining <= 0 else "`solver.time_limit`"
        ended = f"; {key} ended {self.activity}" if self.activity else ""
        raise LimitReached(
            f"no plan found {self.describe_limit()}. {self.describe_failures()}{ended}",
            stage="motion",
        )

    def describe_limit(self) -> str:
        """Return in words which limit ended the search."""
        if self.remaining <= 0:
            return f"with {self.max_programs} nonlinear programs and task plans tried"
        return f"within {self.time_limit:g} s"

    def iterate_choices(self, choices: Iterable[T], label: str) -> Iterator[T]:
        """Yield choices of branches one by one, and count each.

        Raises:
            LimitReached: The budget or time of the whole planning is used up.
        """
        for index, choice in enumerate(choices):
            self.begin(f"{label}, choice {index + 1} of branches")
            yield choice

    def split(self, max_programs: int) -> SearchBudget:
        """Return the budget of a part of the planning with the same deadline; `merge` it
        afterwards.
        """
        share_of_budget = SearchBudget(self.time_limit, min(max_programs, self.remaining))
        share_of_budget.deadline, share_of_budget.cached_outcomes = (
            self.deadline,
            self.cached_outcomes,
        )
        return share_of_budget

    def merge(self, share_of_budget: SearchBudget) -> None:
        """Add the use and the notes of a part of the planning."""
        self.work += share_of_budget.work
        self.num_sequences += share_of_budget.num_sequences
        self.notes += share_of_budget.notes
        self.variables = share_of_budget.variables or self.variables
        self.constraints = share_of_budget.constraints or self.constraints

    def describe_failures(self) -> str:
        """Return in words what was tried."""
        failures = "; ".join(note for note in dict.fromkeys(self.notes) if note)
        programs = f" ({self.work.programs} programs, {self.work.seconds:.1f} s)"
        summary = f"Tried: {failures}" if failures else "No attempt was completed"
        return summary + (programs if self.work.programs else "")

    def record(self, outcome: ProgramAnswer, label: str) -> None:
        """Add the work of the programs solved for one answer, and note a failure."""
        self.work += outcome.work
        self.variables, self.constraints = outcome.variables, outcome.constraints
        if not outcome.solved:
            self.notes.append(f"{label}: {outcome.message}")
