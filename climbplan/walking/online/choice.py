"""What a tick has found so far, and the command that it ends with."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from climbplan.walking.online.attempt import Attempt, Budget, Progress
from climbplan.walking.task.task import WalkTrajectory

LAST, FALLBACK, SAFE = -1, -2, -3  # winners that are no section of the library
KEPT = -4  # no winner: between knots the plan before goes on


@dataclass(frozen=True)
class Command:
    """What the robot is to do from now on."""

    trajectory: WalkTrajectory
    winner: int  # section of the library, or LAST, FALLBACK, SAFE, KEPT
    tried: int
    tick_time: float  # [s] of processor time of this thread
    solve_time: float  # [s] of it in QPs and their checks
    warning: str = ""
    qps: int = 0
    holds: bool = False  # on the nonlinear dynamics
    first: float = 0.0  # [s] of its first interval where that is shorter than usual


@dataclass
class Choice:
    """What a tick found so far.

    best: (cost, walk, winner, first) of what holds; nearest: (excess, walk, winner, first) of what
    misses; first: as of `Command`.
    """

    budget: Budget
    best: tuple[float, WalkTrajectory, int, float] | None = None
    nearest: tuple[float, WalkTrajectory, int, float] | None = None
    # By gait, winner, and whether the first interval is shorter
    begun: dict[tuple[bytes, int, bool], Progress] = field(default_factory=dict)
    tried: int = 0
    held: int = 0
    solving: float = 0.0  # [s] by the clock
    begin: float = field(default_factory=time.thread_time)
    clock: float = field(default_factory=time.perf_counter)

    def weigh(self, found: Attempt, winner: int, first: float) -> None:
        """Take it if it is the cheapest that holds, or the nearest miss; first: as of `Command`."""
        walk = found.trajectory
        if found.holds:
            self.held += 1
            if self.best is None or found.cost < self.best[0]:
                self.best = (found.cost, walk, winner, first)
        elif self.nearest is None or found.excess < self.nearest[0]:
            self.nearest = (found.excess, walk, winner, first)

    def command(self, walk: WalkTrajectory, winner: int, first: float, warning: str) -> Command:
        """The command with what it took."""
        spent = time.thread_time() - self.begin
        # Asking for processor time takes as long as half a QP: once a tick, shares by the clock.
        share = self.solving / max(time.perf_counter() - self.clock, 1e-9)
        solving = min(share, 1.0) * spent
        held = self.best is not None
        qps = self.budget.qps
        return Command(walk, winner, self.tried, spent, solving, warning, qps, held, first)
