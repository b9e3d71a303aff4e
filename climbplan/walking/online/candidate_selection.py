"""Selection among the candidates of one tick, and the command that the tick ends with."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import NamedTuple

from climbplan.walking.online.gait_solver import GaitSolution, IterationBudget, SqpProgress
from climbplan.walking.task.task import WalkTrajectory

PREVIOUS_PLAN, NAMED_GAIT, SAFE_STANCE = -1, -2, -3  # sources that are no section of the library
PLAN_CONTINUES = -4  # no new plan: between knots the previous one continues


@dataclass(frozen=True)
class Command:
    """The command of one tick, in force from its delay on."""

    trajectory: WalkTrajectory
    source: int  # index of a section of the library, or one of the constants above
    num_candidates: int
    tick_time: float  # [s] processor time of this thread
    solve_time: float  # [s] of it in QPs and their validation
    warning: str = ""
    num_qps: int = 0
    is_feasible: bool = False  # the nonlinear rollout validates the plan
    # [s] length of the first interval where it is shorter than usual; 0: as usual
    first_interval: float = 0.0


class RankedPlan(NamedTuple):
    """A candidate's plan with the figure that it is ranked by."""

    score: float  # cost of a feasible plan, violation of an infeasible one
    trajectory: WalkTrajectory
    source: int  # as `Command.source`
    first_interval: float  # [s] length of the first interval where it is shorter; 0: as usual


@dataclass
class CandidateSelection:
    """The best candidates of a tick so far, and the work spent on them."""

    budget: IterationBudget
    best: RankedPlan | None = None  # cheapest feasible plan
    nearest: RankedPlan | None = None  # infeasible plan of least violation
    # SQP iterations by gait, source, and whether the first interval is shorter
    progress: dict[tuple[bytes, int, bool], SqpProgress] = field(default_factory=dict)
    num_tried: int = 0
    num_feasible: int = 0
    solve_clock: float = 0.0  # [s] wall-clock time in QPs and their validation
    cpu_start: float = field(default_factory=time.thread_time)
    clock_start: float = field(default_factory=time.perf_counter)

    def record(self, solution: GaitSolution, source: int, first_interval: float) -> None:
        """Keep a solution if it is the cheapest feasible one or the one of least violation.

        Args:
            solution: the candidate's solution.
            source: the candidate's origin, as `Command.source`.
            first_interval: length of the first interval where it is shorter, else 0 [s].
        """
        plan = solution.trajectory
        if solution.is_feasible:
            self.num_feasible += 1
            if self.best is None or solution.cost < self.best.score:
                self.best = RankedPlan(solution.cost, plan, source, first_interval)
        elif self.nearest is None or solution.violation < self.nearest.score:
            self.nearest = RankedPlan(solution.violation, plan, source, first_interval)

    def build_command(
        self, trajectory: WalkTrajectory, source: int, first_interval: float, warning: str
    ) -> Command:
        """Return the command of a plan with the statistics of the tick."""
        cpu_time = time.thread_time() - self.cpu_start
        # Reading the processor time takes as long as half a QP. It is therefore read once a tick
        # and divided by wall-clock fractions.
        solve_fraction = self.solve_clock / max(time.perf_counter() - self.clock_start, 1e-9)
        return Command(
            trajectory=trajectory,
            source=source,
            num_candidates=self.num_tried,
            tick_time=cpu_time,
            solve_time=min(solve_fraction, 1.0) * cpu_time,
            warning=warning,
            num_qps=self.budget.num_qps,
            is_feasible=self.best is not None,
            first_interval=first_interval,
        )
