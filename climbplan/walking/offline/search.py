"""Iterated local search over gaits (Lourenco et al. 2003): each gait is priced by SQP.

Moves flip contacts of knots and legs. At a local optimum a few random moves perturb the best gait.
No gait is priced twice. The outcome depends on the seed and the budget of QPs, not on the machine:
the time limit is a cap, and an answer that it cut short says so.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.progress import report_search
from climbplan.walking.check.checker import is_feasible
from climbplan.walking.offline.fixed_contact_qp import WalkIterate
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.gait_moves import (
    find_neighbour_regions,
    generate_region_moves,
    list_contact_moves,
)
from climbplan.walking.offline.gaits import (
    GAITS,
    assign_regions,
    generate_initial_gaits,
    has_enough_contacts,
)
from climbplan.walking.offline.sqp import COARSE_TOLERANCE, GaitAnswer, build_iterate, solve_gait
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.plan.answer import Improvement, WalkAnswer
from climbplan.walking.task.task import Gait, WalkTask

_INITIAL_FRACTION = 0.2  # of the QPs, for glances at named gaits
_GLANCE_QPS = 2  # for each gait
_MAX_FAILED_GLANCES = 12  # before the elastic mode is allowed
_NUM_PROMISING = 4  # glances that are refined
_NUM_PROMISING_INFEASIBLE = 8  # the same while no gait is feasible
_FULL_QPS = 8
_POLISH_QPS = 60
_MAX_POLISHED = 10  # gaits, from the best on, until one is feasible
_POLISH_FRACTION = 0.1  # of the time, reserved for the polish
_KICK_MOVES = (2, 4)  # smallest and largest number of random moves
_MAX_FAILED_KICKS = 100  # in succession, which end the search
_KICK_QPS = 3  # after which a gait beyond the violation below is dropped
_MAX_KICK_VIOLATION = 0.02  # [m]
_VIOLATION_PRICE = 1e5  # [1/m] of workspace violation, while no gait is feasible


@dataclass(frozen=True)
class SearchLimits:
    """When a search ends. QPs of the polish of what it found are not counted."""

    seconds: float = np.inf  # a cap, the last part of which is for the polish
    gaits: int = 100_000  # beyond the named ones
    seed: int = 0
    names: tuple[str, ...] = GAITS  # gaits to begin with
    qps: int = 1_000_000_000


def search(task: WalkTask, limits: SearchLimits, first: tuple[Gait, ...] = ()) -> WalkAnswer:
    """Search for the best gait from `first` and the named gaits."""
    return _IteratedLocalSearch(task, limits).run(first)


class _IteratedLocalSearch:
    """The state of a search."""

    def __init__(self, task: WalkTask, limits: SearchLimits) -> None:
        self.task, self.limits = task, limits
        self.random = np.random.default_rng(limits.seed)
        warm_up(task)
        self.begin = time.perf_counter()
        self.priced_gaits: set[bytes] = set()
        self.num_priced = 0  # gaits beyond the named ones
        self.qps = 0
        self.is_timed_out = False  # the time limit cut it short
        self.best: GaitAnswer | None = None
        self.base: GaitAnswer | None = None  # where the local search is
        self.improvements: list[GaitAnswer] = []  # each was the best for a while
        self.history: list[Improvement] = []
        self.neighbour_regions = find_neighbour_regions(task.ground)

    @property
    def seconds(self) -> float:
        """Time since the search began [s]."""
        return time.perf_counter() - self.begin

    @property
    def is_feasible(self) -> bool:
        """True if the best gait is within all limits."""
        return self.best is not None and self.best.is_feasible

    @property
    def is_exhausted(self) -> bool:
        """True if the budget or the time is used up."""
        self.is_timed_out |= self.seconds > (1 - _POLISH_FRACTION) * self.limits.seconds
        is_budget_used = self.qps >= self.limits.qps or self.num_priced >= self.limits.gaits
        return self.is_timed_out or is_budget_used

    @property
    def cut_short(self) -> str:
        """Warning if the time limit ended the search; empty if not."""
        if not self.is_timed_out:
            return ""
        budget = f" of {self.limits.qps}" if self.limits.qps < SearchLimits.qps else ""
        return (
            f"the time limit of {self.limits.seconds:g} s ended the search after "
            f"{self.qps}{budget} QPs: a faster machine may find another answer"
        )

    def solve(
        self,
        gait: Gait,
        start: WalkIterate | None,
        iterations: int,
        elastic: bool = True,
        ceiling: float = np.inf,
    ) -> GaitAnswer:
        """Solve a gait by SQP, and count its QPs."""
        answer = solve_gait(
            self.task,
            gait,
            start,
            iterations,
            0.0,
            COARSE_TOLERANCE,
            elastic=elastic,
            ceiling=ceiling,
        )
        self.qps += answer.iterations
        return answer

    def run(self, first: tuple[Gait, ...]) -> WalkAnswer:
        """Run the search from given gaits."""
        self.evaluate_initial_gaits(first)
        self.base = self.best
        while self.base is not None and not self.is_exhausted:
            if not self.improve(self.base) and not self.perturb():
                break
        return self.polish()

    def polish(self) -> WalkAnswer:
        """Return the best gait that passes the exact check after its SQP has converged.

        After the time limit no further gait is begun; the first always is.
        """
        message = "none has a motion that keeps friction, forces and toes within their limits"
        fallback: tuple[GaitAnswer, str] | None = (
            None  # holds, but breaks a check: better than none
        )
        status = "best gait so far" if self.is_exhausted else "local optimum over gaits"
        for number, candidate in enumerate(
            sorted(self.improvements, key=self.compute_price)[:_MAX_POLISHED]
        ):
            if number and self.seconds > self.limits.seconds:
                self.is_timed_out = True
                break
            assert candidate.trajectory is not None
            gait = candidate.trajectory.gait
            start = build_iterate(candidate.trajectory, gait)
            final = solve_gait(self.task, gait, start, _POLISH_QPS)
            if final.trajectory is None or not final.is_feasible:
                if message.startswith("none"):
                    message = f"the best gait overreaches by {1e3 * final.reach_violation:.1f} mm"
                    if not np.isfinite(final.reach_violation):
                        message = "the QPs of the best gait lead to no motion"
                continue
            if is_feasible(self.task, final.trajectory):
                return self.build_answer(final, status)
            fallback = fallback or (final, status)
        if fallback is not None:
            return self.build_answer(*fallback)
        return WalkAnswer(
            None,
            np.inf,
            self.seconds,
            message,
            tried=len(self.priced_gaits),
            cut_short=self.cut_short,
        )

    def build_answer(self, final: GaitAnswer, message: str) -> WalkAnswer:
        """Return the answer with the statistics of the search."""
        self.history.append(Improvement(self.seconds, final.objective))
        return WalkAnswer(
            final.trajectory,
            final.objective,
            self.seconds,
            message,
            tried=len(self.priced_gaits),
            qps=self.qps,
            cut_short=self.cut_short,
            history=tuple(self.history),
        )

    def evaluate_initial_gaits(self, first: tuple[Gait, ...]) -> None:
        """Glance at given and named gaits by a few QPs, and refine the most promising ones."""
        gaits: list[Gait] = []
        glances: list[GaitAnswer] = []
        for gait in (*first, *generate_initial_gaits(self.task, self.limits.names)):
            if glances and (self.is_exhausted or self.qps > _INITIAL_FRACTION * self.limits.qps):
                break
            if gait.key not in self.priced_gaits:
                self.priced_gaits.add(gait.key)
                has_none = not any(glance.trajectory is not None for glance in glances)
                gaits.append(gait)
                glances.append(
                    self.solve(
                        gait, None, _GLANCE_QPS, has_none and len(glances) >= _MAX_FAILED_GLANCES
                    )
                )
        self.refine_promising(glances)
        if self.is_feasible:
            return
        # None is feasible: retry those without a motion in elastic mode
        retried: list[GaitAnswer] = []
        for gait, glance in zip(gaits, glances, strict=True):
            if retried and (
                self.is_exhausted or self.qps > 2 * _INITIAL_FRACTION * self.limits.qps
            ):
                break
            if glance.trajectory is None:
                retried.append(self.solve(gait, None, _GLANCE_QPS))
        self.refine_promising(retried)

    def refine_promising(self, glances: list[GaitAnswer]) -> None:
        """Refine glances by more QPs, cheapest first."""
        for k, glance in enumerate(sorted(glances, key=lambda answer: answer.predicted)):
            is_enough = k >= (_NUM_PROMISING if self.is_feasible else _NUM_PROMISING_INFEASIBLE)
            is_ended = self.is_exhausted and self.best is not None
            if glance.trajectory is None or is_enough or is_ended or self.is_timed_out:
                break
            answer = glance
            if not glance.has_converged:
                gait = glance.trajectory.gait
                answer = self.solve(gait, build_iterate(glance.trajectory, gait), _FULL_QPS)
            self.record(answer)

    def improve(self, base: GaitAnswer) -> bool:
        """Try the neighbours of a gait until one is better; return whether one is."""
        assert base.trajectory is not None
        for gait in self.generate_neighbours(base.trajectory.gait):
            if gait.key in self.priced_gaits:
                continue
            self.priced_gaits.add(gait.key)
            self.num_priced += 1
            start, ceiling = build_iterate(base.trajectory, gait), self.compute_price(base)
            answer = self.solve(gait, start, _FULL_QPS, not self.is_feasible, ceiling)
            if self.compute_price(answer) < ceiling * (1 - 1e-6):
                self.base = answer
                self.record(answer)
                return True
            if self.is_exhausted:
                return False
        return False

    def perturb(self) -> bool:
        """Move a few random moves away from the best gait; return whether a new gait was found."""
        assert self.best is not None
        assert self.best.trajectory is not None
        incumbent = self.best.trajectory
        for _ in range(_MAX_FAILED_KICKS):
            if self.is_exhausted:
                return False
            contact = incumbent.gait.contact
            for _ in range(int(self.random.integers(_KICK_MOVES[0], _KICK_MOVES[1] + 1))):
                moves = list_contact_moves(contact)
                contact = moves[int(self.random.integers(len(moves)))]
            gait = self.place_gait(incumbent.gait, contact)
            if not has_enough_contacts(self.task, contact) or gait.key in self.priced_gaits:
                continue
            self.priced_gaits.add(gait.key)
            self.num_priced += 1
            answer = self.solve(
                gait, build_iterate(incumbent, gait), _KICK_QPS, not self.is_feasible
            )
            if answer.trajectory is None or (
                self.is_feasible and answer.reach_violation > _MAX_KICK_VIOLATION
            ):
                continue
            answer = self.solve(
                gait, build_iterate(answer.trajectory, gait), _FULL_QPS, not self.is_feasible
            )
            if answer.trajectory is not None and (answer.is_feasible or not self.is_feasible):
                self.base = answer
                self.record(answer)
                return True
        return False

    def record(self, answer: GaitAnswer) -> None:
        """Record an answer if it is the best so far."""
        if self.compute_price(answer) < self.compute_price(self.best) * (1 - 1e-6):
            self.best = answer
            self.improvements.append(answer)
            if answer.is_feasible:
                self.history.append(Improvement(self.seconds, answer.objective))
                report_search(answer.objective)

    @staticmethod
    def compute_price(answer: GaitAnswer | None) -> float:
        """Return the objective of an answer, plus the price of its workspace violation."""
        if answer is None or answer.trajectory is None:
            return np.inf
        return answer.objective + _VIOLATION_PRICE * (
            0.0 if answer.is_feasible else answer.reach_violation
        )

    def generate_neighbours(self, gait: Gait) -> Iterator[Gait]:
        """Yield gaits that are one move away, in random order."""
        moves = list_contact_moves(gait.contact)
        for k in self.random.permutation(len(moves)):
            contact = moves[k]
            if has_enough_contacts(self.task, contact):
                yield self.place_gait(gait, contact)
        allowed = self.task.ground.allowed
        yield from generate_region_moves(gait, self.neighbour_regions, allowed)

    def place_gait(self, gait: Gait, contact: BoolArray) -> Gait:
        """Return a gait with these contacts, on the regions under the best motion.

        Regions under other motions would be misleading.
        """
        if self.task.ground.count == 1 or self.best is None:
            return build_gait(contact, gait.region)
        assert self.best.trajectory is not None
        return assign_regions(self.task, contact, self.best.trajectory.state)
