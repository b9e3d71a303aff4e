"""The result of a planning method for a walking task."""

from __future__ import annotations

from dataclasses import dataclass, field

from climbplan.walking.task.task import WalkTrajectory


@dataclass(frozen=True)
class Improvement:
    """A better trajectory or a better bound during a search."""

    seconds: float
    objective: float
    bound: float = -float("inf")


@dataclass(frozen=True)
class WalkAnswer:
    """A trajectory that obeys the nonlinear dynamics, or the reason why there is none."""

    trajectory: WalkTrajectory | None
    objective: float  # infinite without a trajectory
    seconds: float
    word: str  # message of the method
    bound: float | None = None  # of a relaxation, see `word`
    tubes: int = 0  # attitude boxes whose union the bound covers
    tried: int = 0  # gaits
    qps: int = 0  # of a search, without polishing
    cut_short: str = ""  # a warning if the time limit ended the search
    initial_plan: WalkTrajectory | None = None  # initial solution of `spatial-branch-and-bound`
    history: tuple[Improvement, ...] = field(default=())
