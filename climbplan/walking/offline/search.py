"""Iterated local search over gaits: flips of contacts, of knots and of legs, each priced by SQP.

From a gait that no single move improves it goes on a few random moves away from the best. No gait
is priced twice. What it finds depends on its seed and on its budget of QPs, not on the machine: the
time limit is a cap, and an answer that it cut short says so.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.walking.check.checker import passes
from climbplan.walking.offline.footing import gait_of
from climbplan.walking.offline.gait_moves import (
    contact_moves,
    region_moves,
    regions_beside,
)
from climbplan.walking.offline.gaits import GAITS, enough_contacts, starting_gaits, with_regions
from climbplan.walking.offline.pinned import Iterate
from climbplan.walking.offline.sqp import ROUGHLY, GaitAnswer, iterate_of, solve_gait
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.plan.answer import Improvement, WalkAnswer
from climbplan.walking.task.task import Gait, WalkTask

_FIRST_SHARE = 0.2  # of the QPs, for glances at named gaits
_GLANCE = 2  # QPs
_VAIN = 12  # glances without a motion, after which overreach is allowed
_PROMISING = 4  # named gaits that are looked at further
_UNHELD = 8  # and as long as none holds
_FULL = 8
_POLISH = 60
_POLISHED = 10  # gaits, from the best, until one holds
_POLISH_SHARE = 0.1  # of the time, kept for it
_KICK = (2, 4)  # moves at least and at most
_KICKS = 100  # that lead to no gait that holds, until the search ends
_KICKED = 3  # QPs after which one that overreaches by more than that is given up
_OVERREACH = 0.02  # [m]
_REACH_PRICE = 1e5  # [1/m] where no gait holds yet: less overreach is better


@dataclass(frozen=True)
class SearchLimits:
    """When a search ends. QPs of the polish of what it found are not counted."""

    seconds: float = np.inf  # a cap, the last part of which is for the polish
    gaits: int = 100_000  # beyond the named ones
    seed: int = 0
    names: tuple[str, ...] = GAITS  # gaits to begin with
    qps: int = 1_000_000_000


def search(task: WalkTask, limits: SearchLimits, first: tuple[Gait, ...] = ()) -> WalkAnswer:
    """The best gait found from `first` and the named gaits by local moves."""
    return _Search(task, limits).run(first)


class _Search:
    def __init__(self, task: WalkTask, limits: SearchLimits) -> None:
        self.task, self.limits = task, limits
        self.random = np.random.default_rng(limits.seed)
        warm_up(task)
        self.begin = time.perf_counter()
        self.seen: set[bytes] = set()
        self.priced = 0  # gaits beyond the named ones
        self.qps = 0
        self.late = False  # the time limit cut it short
        self.best: GaitAnswer | None = None
        self.at: GaitAnswer | None = None  # where the local search is
        self.good: list[GaitAnswer] = []  # each was the best for a while
        self.history: list[Improvement] = []
        self.beside = regions_beside(task.ground)

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.begin

    @property
    def holds(self) -> bool:
        return self.best is not None and self.best.holds

    @property
    def spent(self) -> bool:
        self.late |= self.seconds > (1 - _POLISH_SHARE) * self.limits.seconds
        used_up = self.qps >= self.limits.qps or self.priced >= self.limits.gaits
        return self.late or used_up

    @property
    def cut_short(self) -> str:
        """A warning if the time limit ended the search; empty if not."""
        if not self.late:
            return ""
        budget = f" of {self.limits.qps}" if self.limits.qps < SearchLimits.qps else ""
        return (
            f"the time limit of {self.limits.seconds:g} s ended the search after "
            f"{self.qps}{budget} QPs: a faster machine may find another answer"
        )

    def solved(
        self,
        gait: Gait,
        start: Iterate | None,
        iterations: int,
        elastic: bool = True,
        ceiling: float = np.inf,
    ) -> GaitAnswer:
        found = solve_gait(
            self.task, gait, start, iterations, 0.0, ROUGHLY, elastic=elastic, ceiling=ceiling
        )
        self.qps += found.iterations
        return found

    def run(self, first: tuple[Gait, ...]) -> WalkAnswer:
        self.first_round(first)
        self.at = self.best
        while self.at is not None and not self.spent:
            if not self.improve(self.at) and not self.kicked():
                break
        return self.polished()

    def polished(self) -> WalkAnswer:
        """The best gait that passes the exact check once its SQP has settled.

        At the time limit no further gait is begun; one always is.
        """
        word = "none has a motion that keeps friction, forces and toes within their limits"
        nearest: tuple[GaitAnswer, str] | None = None  # holds, but breaks a check: better than none
        complete = "best gait so far" if self.spent else "local optimum over gaits"
        for number, candidate in enumerate(sorted(self.good, key=self.price)[:_POLISHED]):
            if number and self.seconds > self.limits.seconds:
                self.late = True
                break
            assert candidate.trajectory is not None
            gait = candidate.trajectory.gait
            start = iterate_of(candidate.trajectory, gait)
            final = solve_gait(self.task, gait, start, _POLISH)
            if final.trajectory is None or not final.holds:
                if word.startswith("none"):
                    word = f"the best gait overreaches by {1e3 * final.reach:.1f} mm"
                    if not np.isfinite(final.reach):
                        word = "the QPs of the best gait lead to no motion"
                continue
            if passes(self.task, final.trajectory):
                return self.answer(final, complete)
            nearest = nearest or (final, complete)
        if nearest is not None:
            return self.answer(*nearest)
        return WalkAnswer(
            None, np.inf, self.seconds, word, tried=len(self.seen), cut_short=self.cut_short
        )

    def answer(self, final: GaitAnswer, word: str) -> WalkAnswer:
        self.history.append(Improvement(self.seconds, final.objective))
        return WalkAnswer(
            final.trajectory,
            final.objective,
            self.seconds,
            word,
            tried=len(self.seen),
            qps=self.qps,
            cut_short=self.cut_short,
            history=tuple(self.history),
        )

    def first_round(self, first: tuple[Gait, ...]) -> None:
        """Given and named gaits: a glance at each, then the most promising in full."""
        named: list[Gait] = []
        glances: list[GaitAnswer] = []
        for gait in (*first, *starting_gaits(self.task, self.limits.names)):
            if glances and (self.spent or self.qps > _FIRST_SHARE * self.limits.qps):
                break
            if gait.key not in self.seen:
                self.seen.add(gait.key)
                none = not any(glance.trajectory is not None for glance in glances)
                named.append(gait)
                glances.append(self.solved(gait, None, _GLANCE, none and len(glances) >= _VAIN))
        self.refine_promising(glances)
        if self.holds:
            return
        # None holds: those without a motion once more, by the least overreach
        again: list[GaitAnswer] = []
        for gait, glance in zip(named, glances, strict=True):
            if again and (self.spent or self.qps > 2 * _FIRST_SHARE * self.limits.qps):
                break
            if glance.trajectory is None:
                again.append(self.solved(gait, None, _GLANCE))
        self.refine_promising(again)

    def refine_promising(self, glances: list[GaitAnswer]) -> None:
        """Go on from glances, cheapest first."""
        for k, glance in enumerate(sorted(glances, key=lambda found: found.predicted)):
            enough = k >= (_PROMISING if self.holds else _UNHELD)
            ended = self.spent and self.best is not None
            if glance.trajectory is None or enough or ended or self.late:
                break
            found = glance
            if not glance.agreed:
                gait = glance.trajectory.gait
                found = self.solved(gait, iterate_of(glance.trajectory, gait), _FULL)
            self.keep(found)

    def improve(self, at: GaitAnswer) -> bool:
        """Go through the neighbours until one is better; False if none is."""
        assert at.trajectory is not None
        for gait in self.neighbours(at.trajectory.gait):
            if gait.key in self.seen:
                continue
            self.seen.add(gait.key)
            self.priced += 1
            start, ceiling = iterate_of(at.trajectory, gait), self.price(at)
            found = self.solved(gait, start, _FULL, not self.holds, ceiling)
            if self.price(found) < ceiling * (1 - 1e-6):
                self.at = found
                self.keep(found)
                return True
            if self.spent:
                return False
        return False

    def kicked(self) -> bool:
        """Go on a few random moves away from the best; False if nothing new is found there."""
        assert self.best is not None
        assert self.best.trajectory is not None
        begin = self.best.trajectory
        for _ in range(_KICKS):
            if self.spent:
                return False
            contact = begin.gait.contact
            for _ in range(int(self.random.integers(_KICK[0], _KICK[1] + 1))):
                moves = contact_moves(contact)
                contact = moves[int(self.random.integers(len(moves)))]
            gait = self.settled(begin.gait, contact)
            if not enough_contacts(self.task, contact) or gait.key in self.seen:
                continue
            self.seen.add(gait.key)
            self.priced += 1
            found = self.solved(gait, iterate_of(begin, gait), _KICKED, not self.holds)
            if found.trajectory is None or (self.holds and found.reach > _OVERREACH):
                continue
            found = self.solved(gait, iterate_of(found.trajectory, gait), _FULL, not self.holds)
            if found.trajectory is not None and (found.holds or not self.holds):
                self.at = found
                self.keep(found)
                return True
        return False

    def keep(self, found: GaitAnswer) -> None:
        """Take note of the best so far."""
        if self.price(found) < self.price(self.best) * (1 - 1e-6):
            self.best = found
            self.good.append(found)
            if found.holds:
                self.history.append(Improvement(self.seconds, found.objective))

    @staticmethod
    def price(answer: GaitAnswer | None) -> float:
        if answer is None or answer.trajectory is None:
            return np.inf
        return answer.objective + _REACH_PRICE * (0.0 if answer.holds else answer.reach)

    def neighbours(self, gait: Gait) -> Iterator[Gait]:
        """Gaits one move away, in random order."""
        moves = contact_moves(gait.contact)
        for k in self.random.permutation(len(moves)):
            contact = moves[k]
            if enough_contacts(self.task, contact):
                yield self.settled(gait, contact)
        yield from region_moves(gait, self.beside)

    def settled(self, gait: Gait, contact: BoolArray) -> Gait:
        """A gait with these contacts, on the regions under the best motion: others mislead."""
        if self.task.ground.count == 1 or self.best is None:
            return gait_of(contact, gait.region)
        assert self.best.trajectory is not None
        return with_regions(self.task, contact, self.best.trajectory.state)
