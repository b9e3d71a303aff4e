"""What a method answers to a walking task."""

from __future__ import annotations

from dataclasses import dataclass, field

from climbplan.walking.task.task import WalkTrajectory


@dataclass(frozen=True)
class Improvement:
    """A better trajectory was found, or a better bound proved."""

    seconds: float
    objective: float
    bound: float = -float("inf")


@dataclass(frozen=True)
class WalkAnswer:
    """A trajectory that obeys the nonlinear dynamics, or the reason why there is none."""

    trajectory: WalkTrajectory | None
    objective: float  # infinite without a trajectory
    seconds: float
    word: str  # what the method says of its answer
    bound: float | None = None  # of a relaxation, see `word`
    tubes: int = 0  # of attitudes, whose union the bound is of
    tried: int = 0  # gaits
    qps: int = 0  # of a search, its polish not counted
    cut_short: str = ""  # a warning if the time limit did so, and so the machine's speed
    begun: WalkTrajectory | None = None  # what `micp` started from
    history: tuple[Improvement, ...] = field(default=())
