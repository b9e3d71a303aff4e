"""Local search over gaits: flips of single contacts, of knots and of legs, each priced by SQP."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.mpc.answer import Improvement, WalkAnswer
from climbplan.mpc.footing import gait_of
from climbplan.mpc.gaits import enough_contacts, starting_gaits, with_regions
from climbplan.mpc.sqp import ROUGHLY, GaitAnswer, iterate_of, solve_gait
from climbplan.mpc.task import LEGS, Flags, Gait, WalkTask

_FIRST_SHARE = 0.35  # of the time, for named gaits
_GLANCE = 4  # QPs after which a gait that is far off is given up
_PROMISING = 8  # named gaits that are looked at further
_FAR_OFF = 1.15  # times the best cost, then
_FULL = 15
_POLISH = 60
_POLISHED = 10  # gaits, from the best, until one holds
_REACH_PRICE = 1e5  # [1/m] where no gait holds yet: less overreach is better


@dataclass(frozen=True)
class SearchLimits:
    """When a search ends."""

    seconds: float
    gaits: int = 100_000  # beyond the named ones
    seed: int = 0


def search(task: WalkTask, limits: SearchLimits, first: tuple[Gait, ...] = ()) -> WalkAnswer:
    """The best gait found from `first` and the named gaits by local moves."""
    return _Search(task, limits).run(first)


class _Search:
    def __init__(self, task: WalkTask, limits: SearchLimits) -> None:
        self.task, self.limits = task, limits
        self.random = np.random.default_rng(limits.seed)
        self.begin = time.perf_counter()
        self.seen: set[bytes] = set()
        self.priced = 0  # gaits beyond the named ones
        self.best: GaitAnswer | None = None
        self.good: list[GaitAnswer] = []  # each was the best for a while
        self.history: list[Improvement] = []

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.begin

    @property
    def holds(self) -> bool:
        return self.best is not None and self.best.holds

    @property
    def spent(self) -> bool:
        return self.seconds > self.limits.seconds or self.priced >= self.limits.gaits

    def run(self, first: tuple[Gait, ...]) -> WalkAnswer:
        self.first_round(first)
        while self.best is not None and not self.spent:
            if not self.improve(self.best):
                break
        word = "no gait has a QP"
        for candidate in sorted(self.good, key=self.price)[:_POLISHED]:
            assert candidate.trajectory is not None
            gait = candidate.trajectory.gait
            start = iterate_of(candidate.trajectory, gait)
            final = solve_gait(self.task, gait, start, _POLISH)
            if final.trajectory is not None and final.holds:
                found = "local optimum over gaits" if not self.spent else "best gait so far"
                self.history.append(Improvement(self.seconds, final.objective))
                return WalkAnswer(
                    final.trajectory,
                    final.objective,
                    self.seconds,
                    found,
                    tried=len(self.seen),
                    history=tuple(self.history),
                )
            if word.startswith("no"):
                word = f"the best gait overreaches by {1e3 * final.reach:.1f} mm"
        return WalkAnswer(None, np.inf, self.seconds, word, tried=len(self.seen))

    def first_round(self, first: tuple[Gait, ...]) -> None:
        """Given and named gaits: a glance at each, then the most promising in full."""
        glances: list[GaitAnswer] = []
        for gait in (*first, *starting_gaits(self.task)):
            if glances and self.seconds > _FIRST_SHARE * self.limits.seconds:
                break
            if gait.key not in self.seen:
                self.seen.add(gait.key)
                glances.append(solve_gait(self.task, gait, None, _GLANCE, agreement=ROUGHLY))
        for k, glance in enumerate(sorted(glances, key=lambda found: found.predicted)):
            enough = k >= _PROMISING and self.holds
            if glance.trajectory is None or enough or self.spent:
                break
            self.refine(glance)

    def improve(self, best: GaitAnswer) -> bool:
        """Go through the neighbours until one is better; False if none is."""
        assert best.trajectory is not None
        for gait in self.neighbours(best.trajectory.gait):
            if self.consider(gait, best):
                return True
            if self.spent:
                return False
        return False

    def consider(self, gait: Gait, parent: GaitAnswer | None) -> bool:
        """Price a gait; True if it is the best now."""
        if gait.key in self.seen:
            return False
        self.seen.add(gait.key)
        self.priced += 1
        start = None
        if parent is not None and parent.trajectory is not None:
            start = iterate_of(parent.trajectory, gait)
        elastic = not self.holds
        found = solve_gait(self.task, gait, start, _GLANCE, agreement=ROUGHLY, elastic=elastic)
        if found.trajectory is None or found.predicted > _FAR_OFF * self.price(self.best):
            return False
        return self.refine(found)

    def refine(self, found: GaitAnswer) -> bool:
        """Go on from a glance; True if it is the best now."""
        assert found.trajectory is not None
        if not found.agreed:
            gait = found.trajectory.gait
            again = iterate_of(found.trajectory, gait)
            found = solve_gait(self.task, gait, again, _FULL, agreement=ROUGHLY)
        if not self.price(found) < self.price(self.best) * (1 - 1e-6):
            return False
        self.best = found
        self.good.append(found)
        if found.holds:
            self.history.append(Improvement(self.seconds, found.objective))
        return True

    @staticmethod
    def price(answer: GaitAnswer | None) -> float:
        if answer is None or answer.trajectory is None:
            return np.inf
        return answer.objective + _REACH_PRICE * (0.0 if answer.holds else answer.reach)

    def neighbours(self, gait: Gait) -> Iterator[Gait]:
        """Gaits one move away, in random order."""
        moves = list(self.moves(gait.contact))
        for k in self.random.permutation(len(moves)):
            contact = moves[k]
            if enough_contacts(self.task, contact):
                yield self.settled(gait, contact)
        if len(self.task.ground.height) > 1:
            yield from self.other_regions(gait)

    def moves(self, contact: Flags) -> Iterator[Flags]:
        knots = len(contact)
        for n in range(knots):
            for leg in range(LEGS):
                yield _flipped(contact, [n], [leg])
            for pair in ((0, 3), (1, 2), (0, 1), (2, 3)):
                yield _flipped(contact, [n], list(pair))
            yield _flipped(contact, [n], list(range(LEGS)))
        for n in range(knots - 1):
            for leg in range(LEGS):
                yield _flipped(contact, [n, n + 1], [leg])
            swapped = contact.copy()
            swapped[[n, n + 1]] = contact[[n + 1, n]]
            yield swapped
        yield np.concatenate([contact[1:], contact[-1:]])
        yield np.concatenate([contact[:1], contact[:-1]])
        yield contact[:, [1, 0, 3, 2]]

    def settled(self, gait: Gait, contact: Flags) -> Gait:
        if len(self.task.ground.height) == 1 or self.best is None:
            return gait_of(contact, gait.region)
        assert self.best.trajectory is not None
        return with_regions(self.task, contact, self.best.trajectory.state)

    def other_regions(self, gait: Gait) -> Iterator[Gait]:
        """The same contacts with one stance phase on another region."""
        for n in range(1, len(gait.contact)):
            for leg in range(LEGS):
                if gait.contact[n, leg] and not gait.contact[n - 1, leg]:
                    for region in range(len(self.task.ground.height)):
                        if abs(region - gait.region[n, leg]) == 1:
                            changed = gait.region.copy()
                            changed[n, leg] = region
                            yield gait_of(gait.contact, changed)


def _flipped(contact: Flags, knots: list[int], legs: list[int]) -> Flags:
    result = contact.copy()
    result[np.ix_(knots, legs)] ^= True
    return result
