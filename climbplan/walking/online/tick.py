"""One tick of the online controller: candidates' gaits, pinned QPs, the nonlinear check.

The library's sections give all integers. Each is linearised about the section's own motion; a
second QP about the first one's answer follows if the first does not hold (`attempt.py`). So many
QPs are solved in a tick and no more, which bounds its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.kernels.body import PARTS, moved
from climbplan.walking.offline.footing import footing_of
from climbplan.walking.offline.gaits import cycle
from climbplan.walking.offline.pinned import Iterate
from climbplan.walking.online.attempt import Attempt, Budget, GaitTrials
from climbplan.walking.online.candidates import (
    continued,
    flat_gait,
    motion_of,
    reachable,
    usable,
)
from climbplan.walking.online.choice import FALLBACK, KEPT, LAST, SAFE, Choice, Command
from climbplan.walking.online.features import features_of
from climbplan.walking.online.footholds import (
    following,
    gait_on,
    gone_on,
    grounded,
    height_above,
)
from climbplan.walking.online.legs import landed
from climbplan.walking.online.library import SECTION, Library
from climbplan.walking.online.measurement import Situation, fault_of
from climbplan.walking.online.safe_stance import safe_stance
from climbplan.walking.online.strategies import Neighbours, Ranking
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    VELOCITY,
    Gait,
    Start,
    WalkTask,
    WalkTrajectory,
)

_FALLBACKS = (("trot", 0), ("trot", 1), ("stand", 0), ("walking trot", 0), ("walking trot", 2))
_ELASTIC_QPS = 4
_SECOND_LOOKS = 2  # candidates
_FALLBACK_SHARE = 0.6  # of a tick's effort that is kept for named gaits
_DOUBTED = 6  # ticks for which a leg that felt no ground is not stood on
_LOOK_ROUND = 3  # ticks
_NEAR_SPEED, _NEAR_ANGLES = 0.15, 0.06  # [m/s], [rad] from what was expected: as planned
_AT_REFERENCE = 0.1  # [m/s]
_STEADY = 0.03  # [m/s] off the reference that a plan may be for no other to be looked at
_MADE_BEFORE = 200  # programs of gaits
_BEARABLE = 60.0  # slacks that a plan may be off where none holds: better than standing still
Form = Literal["pinned", "published"]


@dataclass(frozen=True)
class OnlineSettings:
    """How a tick spends its time."""

    candidates: int = 8  # gaits of the library that are tried at most
    enough: int = 2  # answers that hold; the cheapest is taken
    iterations: int = 2  # QPs of each gait
    effort: int = 1400  # DAQP iterations in a tick, named gaits included; a QP's assembly counts
    margin: float = 8e-3  # [m] kept inside the workspace boxes by toes yet to be placed
    form: Form = "pinned"  # what is solved: `published.py` says what the other is
    height_weight: float | None = None  # [1/m^2] in place of the task's
    beside: float = 0.0  # share of regions beside the neighbour's that the published form allows


@dataclass(frozen=True)
class _Expected:
    """Where a plan's first knot leads; where no plan was, the task's start."""

    task: WalkTask
    state: Array
    walk: WalkTrajectory | None = None

    @property
    def start(self) -> Start:
        """Standing toes stay, others come down."""
        walk, task = self.walk, self.task
        if walk is None:
            return task.start
        down = landed(task, self.state, walk.toes[1])
        toes = np.where(walk.gait.contact[0][:, None], walk.toes[0], down)
        return Start(self.state, grounded(task.ground, toes))


@dataclass(frozen=True)
class _Candidate:
    winner: int
    gait: Gait
    # What to linearise about, made where it is tried; None for an even motion
    at: Iterate | Callable[[], Iterate] | None
    elastic: bool = False  # the workspace may be left, at a price
    short: bool = False  # the first interval is `Situation.shorter`


class OnlineController:
    """Plans 400 ms ahead at each tick; keeps what it planned last as a candidate."""

    def __init__(
        self,
        task: WalkTask,
        library: Library,
        settings: OnlineSettings,
        ranking: Ranking | None = None,
    ) -> None:
        """task: gives body, ground, references and weights; its horizon is cut to the section's.

        ranking: of the library's sections; their nearest neighbours if None.
        """
        ahead, self._above = horizon_of(task), height_above(task)
        if settings.height_weight is not None:
            ahead = replace(ahead, weights=replace(ahead.weights, height=settings.height_weight))
        self.task = ahead
        self.library, self.settings = library, settings
        self._ranking: Ranking = ranking if ranking is not None else Neighbours(library)
        self._trials = GaitTrials(self.task, settings.margin, settings.beside)
        self._last: WalkTrajectory | None = None
        # At the next tick, if nothing is measured then
        self._expected = _Expected(self.task, task.start.state)
        self._since = 0  # ticks since others than the plan before were looked at
        self._doubted = np.zeros(
            task.body.leg_count, np.int64
        )  # ticks for which a leg is not stood on
        self._flat: dict[int, Gait] = {}  # of sections, on ground of one region
        self._warm_up()

    def tick(self, situation: Situation) -> Command:
        """A checked plan from a situation; a safe stance with a warning if there is none."""
        choice = Choice(Budget(self.settings.effort))
        self._doubted = np.maximum(self._doubted - 1, 0)
        self._doubted[list(situation.unfelt)] = _DOUBTED
        if fault := fault_of(situation, self.task.body):
            return self._safe(choice, fault, self._expected.start)
        start = Start(situation.state, situation.toes)
        task = following(replace(self.task, start=start, first=situation.left), self._above)
        firm = self._doubted == 0
        if situation.airborne is not None:
            firm = firm & ~situation.airborne
        able = reachable(task) & firm
        # Where the body walks as asked, and as planned, others are looked at now and then only.
        self._since += 1
        wanted = float(np.abs(start.state[VELOCITY] - task.reference.velocity[0]).max())
        steady = wanted < _AT_REFERENCE and _near(self._expected.state, start)
        steady = steady and self._since < _LOOK_ROUND and not self._published
        enough = 1 if steady else self.settings.enough
        if not steady:
            self._since = 0
        seen: set[tuple[bytes, bool]] = set()
        soon: tuple[WalkTask, BoolArray] | None = None  # with a shorter first interval, where tried
        for candidate in self._candidates(task, situation, choice, able):
            if choice.tried and choice.budget.spent:
                break
            this, stand = task, able
            if candidate.short:
                if soon is None:
                    early = replace(task, first=situation.shorter)
                    soon = early, reachable(early) & firm
                this, stand = soon
            gait = usable(this, candidate.gait, stand)
            # The published form has other integers, its regions, for the same gait.
            again = candidate.elastic or self._published
            if gait is None or ((gait.key, candidate.short) in seen and not again):
                continue
            seen.add((gait.key, candidate.short))
            at = candidate.at() if callable(candidate.at) else candidate.at
            if gait is not candidate.gait:  # a leg that cannot stand now goes elsewhere
                gait = gait_on(this, gait.contact, None if at is None else at.state)
            choice.tried += 1
            before = time.perf_counter()
            found = self._attempt(this, gait, candidate, at, choice)
            choice.solving += time.perf_counter() - before
            if found is not None:
                choice.weigh(found, candidate.winner, this.first)
                if steady and found.holds and not _keeps_up(task, found.trajectory):
                    enough, self._since = self.settings.enough, 0
                if self._published:
                    break  # what solves is taken, as published
            if choice.held >= enough or (choice.held and candidate.elastic):
                break
        words = [] if len(self.library) else ["the library is empty"]
        if self._doubted.any():
            legs = [
                name
                for name, ticks in zip(task.body.leg_names, self._doubted, strict=True)
                if ticks
            ]
            words.append(f"{', '.join(legs)} without contact")
        taken = choice.best
        if taken is None and situation.left and self._last is not None:
            words.append(f"none of {choice.tried} gaits holds, the plan before goes on")
            return choice.command(self._last, KEPT, 0.0, ", and ".join(words))
        if taken is None:
            words.append(f"none of {choice.tried} gaits holds")
            if choice.nearest is None or (choice.nearest[0] >= _BEARABLE and not self._published):
                return self._safe(choice, ", and ".join(words), task.start, situation.shorter)
            taken = choice.nearest
            words[-1] += ", the nearest is taken"
        self._last = taken[1]
        self._expected = _Expected(task, taken[1].state[1], taken[1])
        return choice.command(*taken[1:], ", and ".join(words))

    def forget(self) -> None:
        """The next tick stands alone: no plan before it, no leg that is doubted."""
        self._last, self._since = None, 0
        self._expected = _Expected(self.task, self.task.start.state)
        self._doubted[:] = 0

    @property
    def _published(self) -> bool:
        return self.settings.form == "published"

    def _warm_up(self) -> None:
        """Load compiled code and make the programs of the commonest gaits, before time counts."""
        contact = self.library.contact.reshape(-1, (SECTION + 1) * self.library.contact.shape[2])
        gaits, count = np.unique(contact, axis=0, return_counts=True)
        # Where there are regions a gait has others in every tick.
        made = _MADE_BEFORE if self.task.ground.endless else 0
        for row in gaits[np.argsort(-count)[:made]]:
            self._trials.program(self.task, flat_gait(row.reshape(SECTION + 1, -1)))
        stand = gait_on(self.task, cycle("stand", self.task.body.leg_count, SECTION), None)
        reachable(self.task)
        named = _Candidate(FALLBACK, stand, None, elastic=True)
        self._attempt(self.task, stand, named, None, Choice(Budget(self.settings.effort)))

    def _candidates(
        self, task: WalkTask, situation: Situation, choice: Choice, able: BoolArray
    ) -> Iterator[_Candidate]:
        """The plan before, sections of the library, and where none of them holds named gaits."""
        first: list[_Candidate] = []
        early = situation.shorter > 0
        falls = early and able.sum() < task.least_contacts
        if self._last is not None and not self._published:
            # Between knots the plan before is still in its first interval
            between = situation.left > 0
            last = self._last
            gait, at = (last.gait, motion_of(last)) if between else continued(last)
            gait = gone_on(task, gait, at, last, SECTION + between)
            first.append(_Candidate(LAST, gait, at))
            yield replace(first[-1], short=True) if falls else first[-1]
        reference = task.reference
        features = features_of(situation, float(reference.height[0]), reference.velocity[0])
        below = 0.0 if task.ground.endless else task.reference.height[0] - self._above
        base = np.array([*situation.state[:2], below])
        named = len(self.library) and not self._published
        kept = 0 if not named else round(_FALLBACK_SHARE * self.settings.effort)
        for index in self._ranking.ranked(features, self.settings.candidates):
            if choice.budget.left <= kept:  # enough for one that is cheaper, too
                break
            first.append(self._section(task, int(index), base))
            yield replace(first[-1], short=True) if falls else first[-1]
        if choice.held or self._published:
            return
        # What is nearly right may leave the workspace a little, legs come down earlier, and the
        # next plan begins then; gaits by name are further off.
        for candidate in first[:_SECOND_LOOKS]:
            yield replace(candidate, elastic=True, short=early)
        for name, phase in _FALLBACKS:
            gait = gait_on(task, cycle(name, task.body.leg_count, SECTION, phase), None)
            yield _Candidate(FALLBACK, gait, None, elastic=True, short=early)

    def _section(self, task: WalkTask, index: int, base: Array) -> _Candidate:
        """A section of the library and its motion, moved to where the body is."""
        state = None if task.ground.endless else self._moved(index, base)
        gait = None if state is not None else self._flat.get(index)
        if gait is None:
            gait = gait_on(task, self.library.contact[index], state)
            if state is None:
                self._flat[index] = gait
        return _Candidate(index, gait, partial(self._motion, gait, index, base))

    def _motion(self, gait: Gait, index: int, base: Array) -> Iterate:
        """A section's motion to linearise about."""
        footing, library = footing_of(gait), self.library
        spots = library.toes[index][footing.first, footing.leg, :2] + base[:2]
        return Iterate(self._moved(index, base), library.force[index, :-1], spots)

    def _moved(self, index: int, base: Array) -> Array:
        state = self.library.state[index].copy()
        state[:, POSITION] += base
        return state

    def _attempt(
        self, task: WalkTask, gait: Gait, candidate: _Candidate, at: Iterate | None, choice: Choice
    ) -> Attempt | None:
        """The answer about a motion; where the tick has tried the candidate before it goes on."""
        program = self._trials.program(task, gait)
        if self._published and at is not None:
            return self._trials.published(task, program, at, choice.budget)
        mark = gait.key, candidate.winner, candidate.short
        progress = choice.begun.get(mark)
        if progress is None:
            progress = choice.begun[mark] = self._trials.begun(task, program, at)
        iterations = _ELASTIC_QPS if candidate.elastic else self.settings.iterations
        return self._trials.attempt(
            task, program, progress, iterations, choice.budget, candidate.elastic
        )

    def _safe(self, choice: Choice, word: str, start: Start, first: float = 0.0) -> Command:
        """Legs down, against motion and tilt, of the measured state or the expected one.

        first: as of `Command`.
        """
        self._last = None
        task = replace(self.task, start=start, first=first)
        walk, body = safe_stance(task), task.body
        # Without a measurement the stance goes on from where it leads: a brake must come to an end.
        after = moved(
            body.mass,
            body.gravity,
            body.inertia,
            body.inverse,
            float(task.steps[0]),
            PARTS,
            start.state,
            start.toes,
            walk.force[0],
        )
        if np.isfinite(after).all():
            self._expected = _Expected(task, after, walk)
        return choice.command(walk, SAFE, first, f"safe stance: {word}")


def _near(expected: Array, start: Start) -> bool:
    """Whether a measured start is as expected."""
    off = np.abs(start.state - expected)
    return bool(off[VELOCITY].max() < _NEAR_SPEED and off[ANGLES].max() < _NEAR_ANGLES)


def _keeps_up(task: WalkTask, walk: WalkTrajectory) -> bool:
    """Whether a plan keeps the velocity that is asked for.

    Its rhythm may not go on: that of a section in which legs come to stand ends slowly.
    """
    off = np.abs(walk.state[1:, VELOCITY] - task.reference.velocity)[:, :2]
    return bool(off.max() < _STEADY)


def horizon_of(task: WalkTask) -> WalkTask:
    """The task over the knots of a section; its references must be constant."""
    reference = task.reference
    return replace(
        task,
        knots=SECTION,
        reference=replace(
            reference,
            velocity=np.tile(reference.velocity[-1], (SECTION, 1)),
            euler=np.tile(reference.euler[-1], (SECTION, 1)),
            height=np.full(SECTION, reference.height[-1]),
        ),
    )
