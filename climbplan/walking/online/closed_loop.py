"""The controller in a loop with the nonlinear rigid body, in continuous time, under pushes.

Every 5 ms or oftener: sensors, at knots a tick of the controller, legs' forces, and a Runge-Kutta
step with them constant. A command comes into force after the delay that computing and actuating it
take.

A push is felt as an acceleration that no planned force explains. A tick then follows as soon as
the velocity is known again, where enough of the interval is left: the first interval of its plan is
the rest of it, in which legs in the air go on, to other places, and legs that stand stay or lift.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import moved
from climbplan.walking.kernels.feet import worst_standing
from climbplan.walking.online.admittance import AdmittanceGains
from climbplan.walking.online.choice import KEPT, Command
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.legs import Phase, Stance, phase_of, standing
from climbplan.walking.online.measurement import Situation
from climbplan.walking.online.perception import Noise, Perception
from climbplan.walking.online.plant import LegForces
from climbplan.walking.online.tick import OnlineController
from climbplan.walking.task.task import STATE, VELOCITY, Gait, RigidBody, WalkTask, WalkTrajectory

RECOVERED = 0.25  # [m/s] off the reference at most
SUDDEN = 50.0  # [m/s^2] beyond what planned forces explain: a push
WORTH = 2  # samples of an interval that a plan between knots has to be in force for, at least
KNOWN = 0.3  # [m/s] deviation of a velocity that is known
_LONGEST_WAIT = 6  # samples for it
_BLIND = 0.08  # [s] without a measurement that a prediction bridges
FALLEN_TILT = 1.05  # [rad] of a body that fell
FALLEN_HEIGHT = 0.42  # of how far toes' boxes lie below the body


@dataclass(frozen=True)
class Push:
    """A sudden change of the body's velocity."""

    time: float  # [s]
    velocity: Array  # (3,) [m/s]


@dataclass(frozen=True)
class Lost:
    """From a time on a leg makes no contact, whatever it is told."""

    time: float  # [s]
    leg: int


@dataclass(frozen=True)
class LoopWorld:
    """What comes between the controller and an ideal robot."""

    pushes: Sequence[Push] = ()
    noise: Noise = field(default_factory=Noise)
    delay: int = 0  # [samples] until a command is in force
    compensate: bool = True  # the controller plans from the state that will be then
    admittance: AdmittanceGains | None = None  # None: legs give the planned force exactly
    estimation: SensorQuality | None = None  # None: the true state with `noise`
    lost: Sequence[Lost] = ()
    at_push: bool = True  # plan anew when a push is felt; else at the next knot
    letting_go: bool = True  # a toe at the edge of what its leg reaches lifts, instead of on
    dropped: float = 0.0  # share of measurements at knots that do not arrive


@dataclass(frozen=True)
class Loop:
    """What happened: samples, commands at every knot."""

    trajectory: WalkTrajectory  # T samples; forces from each to the next
    pushed: Array  # (T, 3) change of velocity at each sample, before its force acts
    commands: tuple[Command, ...]  # (ticks,)
    fell: float | None  # [s]
    overreach: float  # [m] furthest that a standing toe was out of its box within a knot
    told: Array  # (ticks, 12) the state that the controller was told
    true: Array  # (ticks, 12) and what it was when the plan from it came into force
    at: IntArray  # (ticks,) samples of the ticks
    cut_short: bool = False  # the deadline came before the end

    @property
    def ticks(self) -> int:
        """Ticks of the controller."""
        return len(self.commands)


def run_loop(
    controller: OnlineController,
    start: WalkTask,
    duration: float,
    world: LoopWorld | None = None,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
    deadline: float = math.inf,
) -> Loop:
    """Walk from the start of a task until the end, or until the body falls.

    duration [s]: whole knots, one at least. deadline: of `time.monotonic`; the walk ends at the
    first tick after it.
    """
    return _Run(controller, start, world or LoopWorld(), seed).walked(duration, report, deadline)


@contextmanager
def collected_before() -> Iterator[None]:
    """Garbage is collected now, and not among what is there now while ticks are timed.

    A full collection takes as long as fifty ticks: a controller does it before it starts.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@dataclass(frozen=True)
class _Coming:
    """A command's first interval on its way."""

    sample: int  # that it begins at
    phase: Phase
    told: Array  # (12,) the state that it was planned from
    between: bool  # the rest of an interval that is in force, not one of its own
    begun: int  # sample at which that interval begins
    was: int  # sample at which it was to end before
    end: int  # sample at which it ends

    def after(self, stance: Stance, task: WalkTask, state: Array) -> Stance:
        """The stance that follows one, in a state (12,)."""
        if self.between:
            over = self.sample - self.begun
            was, now = self.was - self.begun, self.end - self.begun
            return stance.redirected(task, self.phase, over / was, over / now)
        return stance.followed(task, state, self.phase)


class _Run:
    """A run between two samples."""

    def __init__(
        self, controller: OnlineController, start: WalkTask, world: LoopWorld, seed: int
    ) -> None:
        self.controller, self.task, self.world = controller, controller.task, world
        self.dt, self.whole = self.task.sample, self.task.samples
        self.state: Array = start.start.state.copy()
        self.stance = standing(self.task, start.start.toes.copy())
        # Samples of the phase: its first, the next one's first
        self.begun, self.ends = 0, self.whole
        self.queue: list[_Coming] = []
        self.log: dict[int, _Coming] = {}  # all, by the samples that they begin at
        self.next_tick = 0
        self.felt: int | None = None  # sample of a push that no plan knows of yet
        self.measured: tuple[int, Array, Stance] | None = None  # what was told last
        self.drops = np.random.default_rng([seed, 1])
        self.at: list[int] = []
        self.due = sorted(world.pushes, key=lambda push: push.time)
        self.legs = LegForces(self.task, world.admittance, self.dt)
        self.legs.begin(self.state, self.stance)
        self.perception = Perception(
            self.task, self.state, world.noise, world.estimation, np.random.default_rng(seed)
        )
        self.perception.listen(self.state, self.stance.toes, self.dt)
        self.commands: list[Command] = []
        self.told: list[Array] = []
        self.true: list[Array] = []
        self.rows: list[tuple[Array, Array, Array, BoolArray, Array]] = []
        self.overreach = 0.0

    def walked(
        self, duration: float, report: Callable[[float], None] | None, deadline: float
    ) -> Loop:
        """Until the end, a fall, or the deadline."""
        # At least one knot: a walk without a tick has nothing to judge.
        samples = self.whole * max(1, math.ceil(duration / self.task.step - 1e-9))
        fell, cut_short = None, False
        for sample in range(samples):
            if self.ready(sample):
                self.interrupt(sample)
            if sample == self.next_tick:
                if sample and time.monotonic() > deadline:
                    cut_short = True
                    break
                self.next_tick = sample + self.whole
                self.tick(sample, sample + self.world.delay)
                if report is not None:
                    report(min((sample + self.whole) / samples, 1.0))
            if self.queue and self.queue[0].sample == sample:
                self.begin(self.queue.pop(0))
            self.step(sample)
            if fallen(self.task.body, self.state, self.stance.toes):
                fell = (sample + 1) * self.dt
                break
        toes, stood = self.stance.toes, self.stance.phase.contact & ~self.lost(samples)
        self.rows.append((self.state, toes, np.zeros_like(toes), stood, np.zeros(3)))
        columns = [np.stack(part) for part in zip(*self.rows, strict=True)]
        states, feet, forces, contacts, jumps = columns
        gait = Gait(contacts.astype(bool), self.task.ground.nearest(feet[..., :2]))
        walk = WalkTrajectory(states, feet, forces, gait)
        true = np.array(self.true).reshape(-1, STATE)
        told = np.array(self.told).reshape(-1, STATE)
        commands, at = tuple(self.commands), np.array(self.at, np.int64)
        return Loop(walk, jumps, commands, fell, self.overreach, told, true, at, cut_short)

    @property
    def coming_between(self) -> bool:
        """A plan for the rest of the interval is on its way."""
        return any(coming.between for coming in self.queue)

    def ready(self, sample: int) -> bool:
        """A push was felt, and the velocity is known again."""
        if self.felt is None:
            return False
        sure = self.perception.speed_error < KNOWN
        return sure or sample - self.felt >= _LONGEST_WAIT

    def interrupt(self, sample: int) -> None:
        """A tick between knots, if its plan can do anything before the next plan does."""
        self.felt = None
        begin = sample + self.world.delay
        end = self.next_tick + self.world.delay  # of the interval that is in force by then
        if sample < self.next_tick and end - begin >= WORTH:
            self.tick(sample, begin, end - begin)

    def tick(self, sample: int, begin: int, left: int = 0) -> None:
        """Measure, look ahead to when the plan begins, plan, and queue the plan.

        left: samples until the next knot, if it begins between knots.
        """
        state, toes = self.perception.state_and_toes(self.state, self.stance)
        stance, since = self.stance.thought(toes), sample
        dropped = not left and self.world.dropped > 0
        if dropped and self.drops.random() < self.world.dropped and self.measured is not None:
            since, state, stance = self.measured
        else:
            self.measured = since, state, stance
        if self.world.compensate or since < sample:
            then = begin if self.world.compensate else sample
            state, stance = self.ahead(state, stance, since, then)
        plan = stance.phase.plan
        wanted = stance.phase.contact if plan is None else plan.gait.contact[0]
        unfelt = tuple(int(leg) for leg in np.flatnonzero(wanted & self.lost(sample)))
        # The plan begins when the phase that is in force by then ends: legs in the air come down.
        if left:
            begun, was = self.span(begin)[0], begin + left
            share = (begin - begun) / (was - begun)
            ended = replace(stance, toes=stance.over(self.task, share))
        else:
            begun, was = begin, begin + self.whole
            ended = stance.followed(self.task, state, stance.phase)
        half = self.whole // 2  # of an interval: a shorter one, where no plan holds
        airborne = ~stance.phase.contact if left else np.zeros_like(stance.phase.contact)
        age = max(0.0, (sample - since) * self.dt - _BLIND)
        situation = Situation(
            state,
            ended.toes,
            ended.before,
            ended.stood,
            age=age,
            unfelt=unfelt,
            left=left * self.dt,
            shorter=half * self.dt if self.world.at_push and (left or self.whole) > half else 0.0,
            airborne=airborne,
        )
        command = self.controller.tick(situation)
        self.commands.append(command)
        self.at.append(sample)
        if command.winner == KEPT:
            return
        if command.first:
            self.next_tick = begin + round(command.first / self.dt) - self.world.delay
        end = self.next_tick + self.world.delay
        phase = phase_of(command.trajectory)
        coming = _Coming(begin, phase, state, left > 0, begun, was, end)
        self.queue.append(coming)
        self.log[begin] = coming

    def span(self, sample: int) -> tuple[int, int]:
        """Samples at which the interval that holds a sample begins, and ends."""
        before = [one for one in self.log.values() if one.sample <= sample]
        if not before:
            return 0, self.whole
        last = max(before, key=lambda one: one.sample)
        return last.begun, last.end

    def ahead(self, state: Array, stance: Stance, now: int, then: int) -> tuple[Array, Stance]:
        """State and stance at a later sample, under the phases that are in force until then."""
        body = self.task.body
        for sample in range(now, then):
            if sample in self.log:
                stance = self.log[sample].after(stance, self.task, state)
            state = moved(
                body.mass,
                body.gravity,
                body.inertia,
                body.inverse,
                self.dt,
                1,
                state,
                stance.toes,
                stance.phase.force,
            )
            if self.world.letting_go:
                begun, end = self.span(sample)
                share = min((sample + 1 - begun) / (end - begun), 1.0)
                stance = stance.let_go(self.task, state, share)
        return state, stance

    def begin(self, coming: _Coming) -> None:
        """A command comes into force: as planned, seen from where the body is."""
        self.true.append(self.state.copy())
        self.told.append(coming.told)
        seen = replace(coming, phase=coming.phase.seen_from(self.task, self.state))
        self.stance = seen.after(self.stance, self.task, self.state)
        self.ends = coming.end
        if not coming.between:
            self.begun = coming.sample
        self.legs.begin(self.state, self.stance)

    def step(self, sample: int) -> None:
        """One sample: pushes, forces, motion, and what is felt of it."""
        task, body = self.task, self.task.body
        before = self.state.copy()
        jump = np.zeros(3)
        while self.due and self.due[0].time <= sample * self.dt + 1e-9:
            jump = jump + self.due.pop(0).velocity
        self.state[VELOCITY] += jump
        contact = self.stance.phase.contact & ~self.lost(sample)
        force = self.legs.force(self.state, self.stance, contact)
        shown = self.shown(sample)
        self.rows.append((self.state.copy(), shown, force, contact, jump))
        self.state = moved(
            body.mass,
            body.gravity,
            body.inertia,
            body.inverse,
            self.dt,
            1,
            self.state,
            self.stance.toes,
            force,
        )
        if self.world.letting_go:
            held = self.stance
            self.stance = held.let_go(task, self.state, self.share(sample + 1))
            contact = contact & self.stance.phase.contact
            if self.stance is not held and self.world.at_push and not self.coming_between:
                self.felt = sample
        self.overreach = max(
            self.overreach,
            worst_standing(body.toe_center, body.toe_half, self.state, self.stance.toes, contact),
        )
        self.perception.feel(before, self.state, self.shown(sample + 1), contact, self.dt)
        planned = force.sum(axis=0) / body.mass - [0.0, 0.0, body.gravity]
        felt = self.perception.acceleration(before, self.state, self.dt) - planned
        if self.world.at_push and np.linalg.norm(felt) > SUDDEN:
            self.felt = sample

    def shown(self, sample: int) -> Array:
        """Toes (L, 3) as they are."""
        return self.stance.shown(self.task, self.share(sample))

    def share(self, sample: int) -> float:
        """Of the phase that is in force, which is over by then."""
        return min((sample - self.begun) / (self.ends - self.begun), 1.0)

    def lost(self, sample: int) -> BoolArray:
        """(L,) legs that make no contact."""
        lost = np.zeros(self.task.body.leg_count, bool)
        for one in self.world.lost:
            lost[one.leg] |= one.time <= sample * self.dt + 1e-9
        return lost


def fallen(body: RigidBody, state: Array, toes: Array) -> bool:
    """Whether the body lies down over toes (L, 3), or is nowhere."""
    if not np.isfinite(state).all():
        return True
    least = -FALLEN_HEIGHT * body.toe_center[:, 2].mean()
    tipped = np.abs(state[6:8]).max() > FALLEN_TILT
    return bool(tipped or state[2] - toes[:, 2].min() < least)


def recovered(loop: Loop, task: WalkTask, within: float = RECOVERED) -> bool:
    """Whether the body kept up, and its mean velocity over the last 0.48 s is the reference's."""
    if loop.fell is not None:
        return False
    off = mean_speed(loop.trajectory, task.sample) - task.reference.velocity[-1]
    return bool(np.linalg.norm(off[:2]) < within)


def mean_speed(walk: WalkTrajectory, dt: float) -> Array:
    """(3,) mean velocity over the last 0.48 s of samples that are dt apart."""
    last = max(1, round(0.48 / dt))
    mean: Array = walk.state[-last:, VELOCITY].mean(axis=0)
    return mean
