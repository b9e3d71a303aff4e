"""Closed-loop simulation: controller and nonlinear rigid body in continuous time, with pushes.

At least every 5 ms: sensors, a tick of the controller at knots, contact forces, and a Runge-Kutta
step with constant forces. A command comes into force after the delay of computation and actuation.

A push is detected as an acceleration that the planned forces do not explain. A tick follows as
soon as the velocity estimate has converged, if enough of the interval is left. The first interval
of its plan is the rest of the present one. Swinging legs continue to new landings, and standing
legs stay or lift.
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
from climbplan.walking.kernels.body import integrate_rk4
from climbplan.walking.kernels.toe_workspace import compute_stance_violation
from climbplan.walking.online.admittance import AdmittanceGains
from climbplan.walking.online.candidate_selection import PLAN_CONTINUES, Command
from climbplan.walking.online.contact_forces import LegForces
from climbplan.walking.online.controller import OnlineController
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.stance import (
    StancePhase,
    ToeStance,
    build_stance,
    extract_first_phase,
)
from climbplan.walking.online.state_feedback import StateFeedback, StateNoise
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.task.task import STATE, VELOCITY, Gait, RigidBody, WalkTask, WalkTrajectory

RECOVERY_TOLERANCE = 0.25  # [m/s] from the reference
PUSH_ACCELERATION = 50.0  # [m/s^2] unexplained by planned forces
MIN_REPLANNED_SAMPLES = 2  # for which a plan between knots is in force
MAX_VELOCITY_STD = 0.3  # [m/s] of a converged velocity estimate
_MAX_WAIT_SAMPLES = 6  # for the velocity estimate to converge
_MAX_PREDICTION = 0.08  # [s] without a measurement
FALLEN_TILT = 1.05  # [rad] of roll and pitch
FALLEN_HEIGHT = 0.42  # as a fraction of the depth of the toes' boxes below the body


@dataclass(frozen=True)
class Push:
    """A sudden change of the body's velocity."""

    time: float  # [s]
    velocity: Array  # (3,) [m/s]


@dataclass(frozen=True)
class ContactLoss:
    """A leg that makes no contact from some time on, whatever its command."""

    time: float  # [s]
    leg: int


@dataclass(frozen=True)
class LoopScenario:
    """The simulation scenario: disturbances, sensors, delay and legs."""

    pushes: Sequence[Push] = ()
    noise: StateNoise = field(default_factory=StateNoise)
    delay_samples: int = 0  # from measurement to command
    compensate_delay: bool = True  # plan from the state predicted for the end of the delay
    admittance: AdmittanceGains | None = None  # None: legs exert the planned force exactly
    estimation: SensorQuality | None = None  # None: the true state with `noise`
    contact_losses: Sequence[ContactLoss] = ()
    replan_at_push: bool = True  # when a push is detected; else at the next knot
    lift_unreachable_feet: bool = True  # before the interval ends
    dropout_probability: float = 0.0  # of measurements at knots


@dataclass(frozen=True)
class LoopResult:
    """The trajectory of a closed-loop simulation with the controller's commands."""

    trajectory: WalkTrajectory  # T samples; forces from each to the next
    push_velocity: Array  # (T, 3) [m/s] velocity jump at each sample, before its force acts
    commands: tuple[Command, ...]  # (ticks,)
    fall_time: float | None  # [s]
    reach_violation: float  # [m] largest workspace violation of a standing toe
    estimated_states: Array  # (commands, 12) state from which each plan starts
    true_states: Array  # (commands, 12) true state when the plan came into force
    tick_samples: IntArray  # (ticks,) sample of each tick
    cut_short: bool = False  # by the deadline

    @property
    def num_ticks(self) -> int:
        """Number of ticks of the controller."""
        return len(self.commands)


def simulate_loop(
    controller: OnlineController,
    start: WalkTask,
    duration: float,
    scenario: LoopScenario | None = None,
    *,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
    deadline: float = math.inf,
) -> LoopResult:
    """Simulate a walk from the start of a task until its end or a fall.

    Args:
        controller: the controller, which keeps its previous plan.
        start: task whose start is the first state.
        duration: [s], rounded up to whole knots, at least one.
        scenario: disturbances, sensors, delay and legs; None: an ideal robot.
        seed: of noise and dropouts.
        report: receives the fraction that is done.
        deadline: of `time.monotonic` [s]; the walk ends at the first tick after it.
    """
    return _LoopState(controller, start, scenario or LoopScenario(), seed).simulate(
        duration, report, deadline
    )


@contextmanager
def freeze_garbage() -> Iterator[None]:
    """Collect garbage now and exempt present objects from collection while ticks are timed.

    A full collection takes as long as fifty ticks.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@dataclass(frozen=True)
class _QueuedCommand:
    """The first interval of a command that is not yet in force."""

    sample: int  # at which it comes into force
    phase: StancePhase
    planned_state: Array  # (12,) from which the plan starts
    is_mid_interval: bool  # it replaces the rest of the present interval
    interval_start: int  # sample
    previous_end: int  # sample at which the interval would have ended
    interval_end: int  # sample

    def apply_to(self, stance: ToeStance, task: WalkTask, state: Array) -> ToeStance:
        """Return the stance once the command is in force, in a state (12,)."""
        if self.is_mid_interval:
            elapsed = self.sample - self.interval_start
            previous_length = self.previous_end - self.interval_start
            new_length = self.interval_end - self.interval_start
            return stance.replace_plan(
                task, self.phase, elapsed / previous_length, elapsed / new_length
            )
        return stance.start_phase(task, state, self.phase)


class _LoopState:
    """The simulation state between two samples."""

    def __init__(
        self, controller: OnlineController, start: WalkTask, scenario: LoopScenario, seed: int
    ) -> None:
        self.controller, self.task, self.scenario = controller, controller.task, scenario
        self.dt, self.interval_samples = self.task.sample, self.task.samples
        self.state: Array = start.start.state.copy()
        self.stance = build_stance(self.task, start.start.toes.copy())
        # First samples of the present and of the next phase
        self.phase_start, self.phase_end = 0, self.interval_samples
        self.queue: list[_QueuedCommand] = []
        self.scheduled: dict[int, _QueuedCommand] = {}  # all commands, by first sample
        self.next_tick = 0
        self.replan_request_sample: int | None = None  # at which a new plan was requested
        self.last_measurement: tuple[int, Array, ToeStance] | None = None
        self.dropout_rng = np.random.default_rng([seed, 1])
        self.tick_samples: list[int] = []
        self.pending_pushes = sorted(scenario.pushes, key=lambda push: push.time)
        self.leg_forces = LegForces(self.task, scenario.admittance, self.dt)
        self.leg_forces.start_phase(self.state, self.stance)
        self.feedback = StateFeedback(
            self.task, self.state, scenario.noise, scenario.estimation, np.random.default_rng(seed)
        )
        self.feedback.calibrate_at_rest(self.state, self.stance.toes, self.dt)
        self.commands: list[Command] = []
        self.estimated_states: list[Array] = []
        self.true_states: list[Array] = []
        self.records: list[tuple[Array, Array, Array, BoolArray, Array]] = []
        self.reach_violation = 0.0

    def simulate(
        self, duration: float, report: Callable[[float], None] | None, deadline: float
    ) -> LoopResult:
        """Simulate until the end, a fall, or the deadline."""
        # At least one knot: a walk without a tick has nothing to evaluate.
        samples = self.interval_samples * max(1, math.ceil(duration / self.task.dt - 1e-9))
        fall_time, cut_short = None, False
        for sample in range(samples):
            if self.is_ready_to_replan(sample):
                self.replan(sample)
            if sample == self.next_tick:
                if sample and time.monotonic() > deadline:
                    cut_short = True
                    break
                self.next_tick = sample + self.interval_samples
                self.run_tick(sample, sample + self.scenario.delay_samples)
                if report is not None:
                    report(min((sample + self.interval_samples) / samples, 1.0))
            if self.queue and self.queue[0].sample == sample:
                self.start_command(self.queue.pop(0))
            self.advance_sample(sample)
            if has_fallen(self.task.body, self.state, self.stance.toes):
                fall_time = (sample + 1) * self.dt
                break
        toes, final_contact = (
            self.stance.toes,
            self.stance.phase.contact & ~self.find_lost_contacts(samples),
        )
        self.records.append((self.state, toes, np.zeros_like(toes), final_contact, np.zeros(3)))
        channels = [np.stack(channel) for channel in zip(*self.records, strict=True)]
        states, toe_samples, forces, contacts, velocity_jumps = channels
        gait = Gait(contacts.astype(bool), self.task.ground.nearest(toe_samples[..., :2]))
        walk = WalkTrajectory(states, toe_samples, forces, gait)
        true_states = np.array(self.true_states).reshape(-1, STATE)
        estimated_states = np.array(self.estimated_states).reshape(-1, STATE)
        commands, tick_samples = tuple(self.commands), np.array(self.tick_samples, np.int64)
        return LoopResult(
            trajectory=walk,
            push_velocity=velocity_jumps,
            commands=commands,
            fall_time=fall_time,
            reach_violation=self.reach_violation,
            estimated_states=estimated_states,
            true_states=true_states,
            tick_samples=tick_samples,
            cut_short=cut_short,
        )

    @property
    def has_queued_replan(self) -> bool:
        """True if a plan for the rest of the interval is queued."""
        return any(queued.is_mid_interval for queued in self.queue)

    def is_ready_to_replan(self, sample: int) -> bool:
        """Return whether a plan was requested and the velocity estimate has converged since."""
        if self.replan_request_sample is None:
            return False
        is_velocity_known = self.feedback.velocity_std < MAX_VELOCITY_STD
        return is_velocity_known or sample - self.replan_request_sample >= _MAX_WAIT_SAMPLES

    def replan(self, sample: int) -> None:
        """Run a tick between knots if its plan comes into force well before the next one."""
        self.replan_request_sample = None
        start_sample = sample + self.scenario.delay_samples
        end_sample = self.next_tick + self.scenario.delay_samples
        if sample < self.next_tick and end_sample - start_sample >= MIN_REPLANNED_SAMPLES:
            self.run_tick(sample, start_sample, end_sample - start_sample)

    def run_tick(self, sample: int, start_sample: int, remaining_samples: int = 0) -> None:
        """Measure, predict the state at the start of the plan (delay compensation), and plan.

        Args:
            sample: of the measurement.
            start_sample: at which the plan comes into force.
            remaining_samples: until the next knot if the plan begins between knots, else 0.
        """
        scenario = self.scenario
        state, stance, measured_at = self._measure(sample, may_drop=not remaining_samples)
        if scenario.compensate_delay or measured_at < sample:
            prediction_end = start_sample if scenario.compensate_delay else sample
            state, stance = self.predict(state, stance, measured_at, prediction_end)
        plan = stance.phase.plan
        planned_contact = stance.phase.contact if plan is None else plan.gait.contact[0]
        undetected = np.flatnonzero(planned_contact & self.find_lost_contacts(sample))
        # The plan begins when the phase that is then in force ends: swinging legs touch down.
        if remaining_samples:
            interval_start = self.find_interval(start_sample)[0]
            previous_end = start_sample + remaining_samples
            fraction = (start_sample - interval_start) / (previous_end - interval_start)
            stance_at_start = replace(stance, toes=stance.project_toes(self.task, fraction))
        else:
            interval_start = start_sample
            previous_end = start_sample + self.interval_samples
            stance_at_start = stance.start_phase(self.task, state, stance.phase)
        half_interval = self.interval_samples // 2
        is_longer = (remaining_samples or self.interval_samples) > half_interval
        in_flight = ~stance.phase.contact
        measurement = TickInput(
            state,
            stance_at_start.toes,
            stance_at_start.previous_toes,
            stance_at_start.previous_contact,
            age=max(0.0, (sample - measured_at) * self.dt - _MAX_PREDICTION),
            undetected_contacts=tuple(int(leg) for leg in undetected),
            time_to_knot=remaining_samples * self.dt,
            short_interval=half_interval * self.dt
            if scenario.replan_at_push and is_longer
            else 0.0,
            airborne=in_flight if remaining_samples else np.zeros_like(in_flight),
        )
        command = self.controller.tick(measurement)
        self.commands.append(command)
        self.tick_samples.append(sample)
        if command.source == PLAN_CONTINUES:
            return
        if command.first_interval:
            first_samples = round(command.first_interval / self.dt)
            self.next_tick = start_sample + first_samples - scenario.delay_samples
        queued = _QueuedCommand(
            sample=start_sample,
            phase=extract_first_phase(command.trajectory),
            planned_state=state,
            is_mid_interval=remaining_samples > 0,
            interval_start=interval_start,
            previous_end=previous_end,
            interval_end=self.next_tick + scenario.delay_samples,
        )
        self.queue.append(queued)
        self.scheduled[start_sample] = queued

    def _measure(self, sample: int, *, may_drop: bool) -> tuple[Array, ToeStance, int]:
        """Return the state (12,), the stance, and the sample of the latest measurement."""
        state, toes = self.feedback.read_state_and_toes(self.state, self.stance)
        stance, measured_at = self.stance.replace_toes(toes), sample
        probability = self.scenario.dropout_probability
        may_drop = may_drop and probability > 0
        if (
            may_drop
            and self.dropout_rng.random() < probability
            and self.last_measurement is not None
        ):
            measured_at, state, stance = self.last_measurement
        else:
            self.last_measurement = measured_at, state, stance
        return state, stance, measured_at

    def find_interval(self, sample: int) -> tuple[int, int]:
        """Return the first samples of the interval that contains a sample, and of the next one."""
        earlier = [queued for queued in self.scheduled.values() if queued.sample <= sample]
        if not earlier:
            return 0, self.interval_samples
        latest = max(earlier, key=lambda queued: queued.sample)
        return latest.interval_start, latest.interval_end

    def predict(
        self, state: Array, stance: ToeStance, from_sample: int, until_sample: int
    ) -> tuple[Array, ToeStance]:
        """Predict state and stance at a later sample under the commands in force until then."""
        body = self.task.body
        for sample in range(from_sample, until_sample):
            if sample in self.scheduled:
                stance = self.scheduled[sample].apply_to(stance, self.task, state)
            state = integrate_rk4(
                body.parameters,
                self.dt,
                1,
                state,
                stance.toes,
                stance.phase.force,
            )
            if self.scenario.lift_unreachable_feet:
                interval_start, interval_end = self.find_interval(sample)
                fraction = min((sample + 1 - interval_start) / (interval_end - interval_start), 1.0)
                stance = stance.lift_unreachable_feet(self.task, state, fraction)
        return state, stance

    def start_command(self, queued: _QueuedCommand) -> None:
        """Bring a command into force, transformed from its planned state to the true one."""
        self.true_states.append(self.state.copy())
        self.estimated_states.append(queued.planned_state)
        transformed = replace(queued, phase=queued.phase.transform_to_state(self.task, self.state))
        self.stance = transformed.apply_to(self.stance, self.task, self.state)
        self.phase_end = queued.interval_end
        if not queued.is_mid_interval:
            self.phase_start = queued.sample
        self.leg_forces.start_phase(self.state, self.stance)

    def advance_sample(self, sample: int) -> None:
        """Simulate one sample: push, forces, motion, sensors, and detection of pushes."""
        task, body = self.task, self.task.body
        previous_state = self.state.copy()
        velocity_jump = np.zeros(3)
        while self.pending_pushes and self.pending_pushes[0].time <= sample * self.dt + 1e-9:
            velocity_jump = velocity_jump + self.pending_pushes.pop(0).velocity
        self.state[VELOCITY] += velocity_jump
        contact = self.stance.phase.contact & ~self.find_lost_contacts(sample)
        force = self.leg_forces.compute_forces(self.state, self.stance, contact)
        toes = self.compute_toes(sample)
        self.records.append((self.state.copy(), toes, force, contact, velocity_jump))
        self.state = integrate_rk4(
            body.parameters,
            self.dt,
            1,
            self.state,
            self.stance.toes,
            force,
        )
        if self.scenario.lift_unreachable_feet:
            stance_before = self.stance
            self.stance = stance_before.lift_unreachable_feet(
                task, self.state, self.phase_fraction(sample + 1)
            )
            contact = contact & self.stance.phase.contact
            if (
                self.stance is not stance_before
                and self.scenario.replan_at_push
                and not self.has_queued_replan
            ):
                self.replan_request_sample = sample
        self.reach_violation = max(
            self.reach_violation,
            compute_stance_violation(body.toe_workspace, self.state, self.stance.toes, contact),
        )
        self.feedback.process_sample(
            previous_state, self.state, self.compute_toes(sample + 1), contact, self.dt
        )
        planned_acceleration = force.sum(axis=0) / body.mass - [0.0, 0.0, body.gravity]
        unexplained = (
            self.feedback.measure_acceleration(previous_state, self.state, self.dt)
            - planned_acceleration
        )
        if self.scenario.replan_at_push and np.linalg.norm(unexplained) > PUSH_ACCELERATION:
            self.replan_request_sample = sample

    def compute_toes(self, sample: int) -> Array:
        """Return toes (L, 3) at a sample."""
        return self.stance.compute_toes(self.task, self.phase_fraction(sample))

    def phase_fraction(self, sample: int) -> float:
        """Return the fraction of the present phase that is over at a sample."""
        return min((sample - self.phase_start) / (self.phase_end - self.phase_start), 1.0)

    def find_lost_contacts(self, sample: int) -> BoolArray:
        """Return the legs (L,) that make no contact."""
        lost = np.zeros(self.task.body.leg_count, bool)
        for loss in self.scenario.contact_losses:
            lost[loss.leg] |= loss.time <= sample * self.dt + 1e-9
        return lost


def has_fallen(body: RigidBody, state: Array, toes: Array) -> bool:
    """Return whether the body lies over its toes (L, 3), is tipped over, or has diverged."""
    if not np.isfinite(state).all():
        return True
    min_height = -FALLEN_HEIGHT * body.toe_center[:, 2].mean()
    is_tipped = np.abs(state[6:8]).max() > FALLEN_TILT
    return bool(is_tipped or state[2] - toes[:, 2].min() < min_height)


def has_recovered(loop: LoopResult, task: WalkTask, tolerance: float = RECOVERY_TOLERANCE) -> bool:
    """Return whether the robot did not fall and tracks the reference velocity at the end.

    Args:
        loop: the simulated walk.
        task: its task.
        tolerance: of the mean velocity over the last 0.48 s [m/s].
    """
    if loop.fall_time is not None:
        return False
    velocity_error = (
        compute_mean_velocity(loop.trajectory, task.sample) - task.reference.velocity[-1]
    )
    return bool(np.linalg.norm(velocity_error[:2]) < tolerance)


def compute_mean_velocity(walk: WalkTrajectory, dt: float) -> Array:
    """Return the mean velocity (3,) over the last 0.48 s of samples dt apart [m/s]."""
    num_samples = max(1, round(0.48 / dt))
    mean: Array = walk.state[-num_samples:, VELOCITY].mean(axis=0)
    return mean
