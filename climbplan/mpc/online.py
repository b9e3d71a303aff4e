"""One tick of the online controller: neighbours' gaits, pinned QPs, the nonlinear check.

The library's nearest sections give all integers. Each is linearised about the neighbour's own
motion; a second QP about the first one's answer follows. What is taken is judged on the nonlinear
dynamics: the rollout of its forces stays within 0.05 m/s and 0.05 rad of the prediction, and toes
stay in their workspace.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.mpc.cost import objective
from climbplan.mpc.dynamics import BodyNumbers, knot_model
from climbplan.mpc.footing import footing_of, gait_of
from climbplan.mpc.gaits import cycle
from climbplan.mpc.library import SECTION, Library, Situation
from climbplan.mpc.pinned import Iterate, PinnedProgram
from climbplan.mpc.sqp import guess, worst_reach
from climbplan.mpc.task import (
    ANGLES,
    LEGS,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Array,
    Flags,
    Gait,
    Start,
    WalkTask,
    WalkTrajectory,
)
from climbplan.mpc.truth import toes_in_body

SPEED_SLACK, ANGLE_SLACK = 0.05, 0.05  # [m/s], [rad] of the rollout over the horizon
REACH_SLACK = 5e-3  # [m]
_FALLBACKS = (("trot", 0), ("trot", 1), ("stand", 0), ("walking trot", 0), ("walking trot", 2))
_FALLBACK_QPS = 6
_BEARABLE = 20.0  # slacks that a plan may be off where none holds: better than standing still
LAST, FALLBACK, SAFE = -1, -2, -3  # winners that are no section of the library
_LARGEST_SPEED, _LARGEST_SPIN, _LARGEST_TILT = 8.0, 25.0, 1.4  # beyond: no measurement


@dataclass(frozen=True)
class OnlineSettings:
    """How a tick spends its time."""

    candidates: int = 8  # gaits that are tried at most
    enough: int = 2  # answers that hold; the cheapest is taken
    iterations: int = 2  # QPs of each gait
    margin: float = 3e-3  # [m] kept inside the workspace boxes


@dataclass(frozen=True)
class Command:
    """What the robot is to do from now on."""

    trajectory: WalkTrajectory
    winner: int  # section of the library, or LAST, FALLBACK, SAFE
    tried: int
    tick_time: float  # [s]
    solve_time: float  # [s] of it in QPs
    warning: str = ""


@dataclass(frozen=True)
class _Tried:
    """A gait's trajectory, and by how many of the slacks it misses them."""

    trajectory: WalkTrajectory
    excess: float  # <= 0 if it holds


class OnlineController:
    """Plans 400 ms ahead at each tick; keeps what it planned last as a candidate."""

    def __init__(self, task: WalkTask, library: Library, settings: OnlineSettings) -> None:
        """task: gives body, ground, references and weights; its horizon is cut to the section's."""
        self.task = horizon_of(task)
        self.library, self.settings = library, settings
        self._single = knot_model(BodyNumbers.of(task.body), 1)
        self._last: WalkTrajectory | None = None
        self._good = task.start  # the last measurement that could be one

    def tick(self, situation: Situation) -> Command:
        """A checked plan from a situation; a safe stance with a warning if there is none."""
        begin = time.perf_counter()
        if fault := fault_of(situation):
            self._last = None
            return self._safe(self._good, begin, 0, 0.0, fault)
        start = Start(situation.state, situation.toes)
        self._good = start
        task = replace(self.task, start=start)
        best: tuple[float, WalkTrajectory, int] | None = None
        nearly: tuple[float, WalkTrajectory, int] | None = None
        tried, held, solving = 0, 0, 0.0
        seen: set[bytes] = set()
        for winner, wanted, at in self._candidates(task, situation):
            if winner == FALLBACK and best is not None:
                break
            gait = usable(task, wanted)
            if gait is None or gait.key in seen:
                continue
            seen.add(gait.key)
            tried += 1
            before = time.perf_counter()
            found = self._solved(task, gait, at, winner == FALLBACK)
            solving += time.perf_counter() - before
            if found is not None and found.excess <= 0:
                held += 1
                walk = found.trajectory
                cost = objective(task, walk.state, walk.force)
                if best is None or cost < best[0]:
                    best = (cost, walk, winner)
            elif found is not None and (nearly is None or found.excess < nearly[0]):
                nearly = (found.excess, found.trajectory, winner)
            if held >= self.settings.enough or (winner == FALLBACK and held):
                break
        warning = "the library is empty" if not len(self.library) else ""
        if best is None and nearly is not None and nearly[0] < _BEARABLE:
            best = nearly
            warning = f"none of {tried} gaits holds, the nearest is taken"
        if best is None:
            self._last = None
            word = f"none of {tried} gaits holds"
            if not len(self.library):
                word = f"the library is empty, and {word}"
            return self._safe(start, begin, tried, solving, word)
        self._last = best[1]
        spent = time.perf_counter() - begin
        return Command(best[1], best[2], tried, spent, solving, warning)

    def _candidates(
        self, task: WalkTask, situation: Situation
    ) -> Iterator[tuple[int, Gait, Iterate | None]]:
        if self._last is not None:
            gait, at = continued(self._last)
            yield LAST, gait, at
        features = situation.features(float(task.reference.height[0]))
        base = np.array([*situation.state[:2], 0.0])
        for index in self.library.nearest(features, self.settings.candidates):
            gait = _flat(self.library.contact[index])
            yield int(index), gait, self._neighbour(int(index), gait, base)
        for name, phase in _FALLBACKS:
            yield FALLBACK, _flat(cycle(name, SECTION, phase)), None

    def _neighbour(self, index: int, gait: Gait, base: Array) -> Iterate:
        library = self.library
        state = library.state[index].copy()
        state[:, POSITION] += base
        footing = footing_of(gait)
        spots = library.toes[index][footing.first, footing.leg, :2] + base[:2]
        return Iterate(state, library.force[index, :-1], spots)

    def _solved(
        self, task: WalkTask, gait: Gait, at: Iterate | None, fallback: bool
    ) -> _Tried | None:
        """The gait's trajectory, judged on the nonlinear dynamics; None without one."""
        program = PinnedProgram(task, gait, self.settings.margin)
        here = guess(task, gait) if at is None else _fitting(program, at)
        for _ in range(_FALLBACK_QPS if fallback else self.settings.iterations):
            found = program.step(here, elastic=fallback)
            if found is None:
                return None
            here = found
        state, toes = self._rollout(task, program, here)
        if not np.isfinite(state).all():
            return None
        off = np.abs(state - here.state)
        force = np.concatenate([here.force, np.zeros((1, LEGS, 3))])
        walk = WalkTrajectory(state, toes, force, gait)
        excess = max(
            float(off[:, VELOCITY].max()) / SPEED_SLACK - 1.0,
            float(off[:, ANGLES].max()) / ANGLE_SLACK - 1.0,
            worst_reach(task, walk) / REACH_SLACK - 1.0,
        )
        return _Tried(walk, excess)

    def _rollout(self, task: WalkTask, program: PinnedProgram, at: Iterate) -> tuple[Array, Array]:
        """States that the forces bring about on the nonlinear dynamics, and the toes."""
        model, toes = self._single, program.toes(at.state, at.spots)
        state = np.empty((task.knots + 1, STATE))
        state[0] = task.start.state
        model.dt[:], model.mean[:] = task.step, float(task.integrator == "mean")
        for n in range(task.knots):
            model.state[0], model.toes[0], model.force[0] = state[n], toes[n], at.force[n]
            model.linearise_step()
            state[n + 1] = model.after[0]
        return state, program.toes(state, at.spots)

    def _safe(self, start: Start, begin: float, tried: int, solving: float, word: str) -> Command:
        """All legs down, each with its share of the weight, against the motion."""
        task = replace(self.task, start=start)
        spent = time.perf_counter() - begin
        return Command(safe_stance(task), SAFE, tried, spent, solving, f"safe stance: {word}")


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


def fault_of(situation: Situation) -> str:
    """Why a measurement cannot be one; empty if it can."""
    numbers = np.concatenate(
        [situation.state, situation.toes.ravel(), situation.toes_before.ravel()]
    )
    if not np.isfinite(numbers).all():
        return "the measurement is not a number"
    state = situation.state
    if np.abs(state[VELOCITY]).max() > _LARGEST_SPEED or np.abs(state[SPIN]).max() > _LARGEST_SPIN:
        return "the measured speed is impossible"
    if np.abs(state[6:8]).max() > _LARGEST_TILT:
        return "the measured tilt leaves no way to stand"
    if np.abs(situation.toes - state[POSITION]).max() > 2.0:
        return "the measured toes are nowhere near the body"
    return ""


def usable(task: WalkTask, gait: Gait) -> Gait | None:
    """The gait without contacts out of reach right now; None if too few are left."""
    body = task.body
    spots = toes_in_body(task.start.state, task.start.toes)
    inside = (np.abs(spots - body.toe_center) <= body.toe_half + REACH_SLACK).all(axis=1)
    contact = gait.contact.copy()
    contact[0] &= inside
    if contact[0].sum() < task.least_contacts:
        contact[0] = inside  # whatever can stand, stands
    if contact[0].sum() < min(task.least_contacts, int(inside.sum())):
        return None
    return gait if np.array_equal(contact, gait.contact) else gait_of(contact, gait.region)


def continued(last: WalkTrajectory) -> tuple[Gait, Iterate]:
    """What is left of a plan after its first knot, and one more knot of the same rhythm."""
    contact = np.vstack([last.gait.contact[1:], last.gait.contact[-2:-1]])
    gait = _flat(contact)
    extended = last.state[-1:].copy()
    step = last.state[-1, POSITION] - last.state[-2, POSITION]
    extended[0, POSITION] += step
    state = np.vstack([last.state[1:], extended])
    force = np.concatenate([last.force[1:-1], last.force[-3:-2]])
    footing = footing_of(gait)
    toes = np.concatenate([last.toes[1:], last.toes[-1:] + step])
    spots = toes[np.minimum(footing.first, len(toes) - 1), footing.leg, :2]
    return gait, Iterate(state, force, spots)


def safe_stance(task: WalkTask) -> WalkTrajectory:
    """All legs down with equal shares of the weight, within friction, against the motion."""
    state = np.tile(task.start.state, (task.knots + 1, 1))
    toes = np.tile(task.start.toes, (task.knots + 1, 1, 1))
    weight = task.body.mass * task.body.gravity / LEGS
    brake = -task.body.mass * task.start.state[VELOCITY][:2] / (LEGS * task.step * task.knots)
    room = 0.5 * task.ground.friction * weight
    brake = brake * min(1.0, room / max(float(np.hypot(*brake)), 1e-9))
    force = np.zeros((task.knots + 1, LEGS, 3))
    force[:-1] = [*brake, weight]
    contact = np.ones((task.knots + 1, LEGS), bool)
    return WalkTrajectory(state, toes, force, _flat(contact))


def _fitting(program: PinnedProgram, at: Iterate) -> Iterate:
    """The start with forces and footholds of the legs that stand in this program only."""
    standing = program.gait.contact[:-1]
    force = np.where(standing[..., None], at.force, 0.0)
    spots = at.spots
    if len(spots) != program.footing.count:
        spots = guess(program.task, program.gait).spots
    return Iterate(at.state, force, spots)


def _flat(contact: Flags) -> Gait:
    """A gait on flat ground."""
    return Gait(np.array(contact, bool), np.zeros(contact.shape, np.int64))
