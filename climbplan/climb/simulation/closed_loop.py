"""Execute a plan in closed loop in MuJoCo, with the sensors of a robot.

Joint encoders have the noise and backlash of the conditions, motor torques an error of scale for
each motor and noise. The delay of the conditions holds for all that the executive reads. A robot
that stops before the end has to hold itself for some time. It then goes on by a plan from where it
stands, if there is one.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.executive.executive import ClimbExecutive
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.model.mjcf import TIME_STEP
from climbplan.climb.simulation.mujoco_run import (
    CONTROL_PERIOD,
    SETTLING_TIME,
    ExecutionRecord,
    MujocoRun,
    RecordedRun,
    Replan,
)
from climbplan.errors import NoPlanFound, UsageError
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.measures import FALLEN, TUMBLED, compute_tilt

_TORQUE_NOISE = 0.005  # standard deviation of a measured torque, by the motor's limit
_HOLDING_TIME = 5.0  # [s] that a stopped robot has to hold itself
_TORQUE_SALT = 0x746F72  # keeps errors of torques apart from other draws of a seed


class ClosedLoopRun(MujocoRun):
    """A MuJoCo model whose commands come from an executive."""

    def __init__(
        self, mujoco: ModuleType, model: Any, data: Any, plan: ClimbPlan, conditions: Conditions
    ) -> None:
        super().__init__(mujoco, model, data, plan, conditions)
        self.executive = ClimbExecutive(plan, self.start.toes)
        self._start_clock, self._start_time = 0.0, 0.0  # [s] of plans before this one
        self._settling_time = SETTLING_TIME
        # What a robot adds to commands: what carries its links, and errors of its footholds
        self._added = self.command - plan.trajectory.joint_command
        shape = plan.robot.limb_count, plan.robot.joint_count
        self._sensor_errors = np.random.default_rng([_TORQUE_SALT, conditions.noise_seed])
        error = conditions.torque_error * self._sensor_errors.standard_normal(shape)
        self._torque_scale = 1.0 + error
        self._torque_noise = _TORQUE_NOISE * plan.robot.max_torque
        self._readings: deque[tuple[Array, Array]] = deque()
        self._rows: list[dict[str, Any]] = []  # one of each sample up to the clock
        self._step_times: list[float] = []
        self._loss_begins: dict[int, float] = {}  # [s] since the start, by number of the loss

    def play(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
        rests: bool,
    ) -> RecordedRun:
        """Execute the plan to its end, a stop or a fall; see `MujocoRun.play`."""
        self._place()
        self.executive.pause(SETTLING_TIME)
        self.data.ctrl[: self.joints] = (self._added[0] + self.executive.command).ravel()
        return self._execute(progress, watch, rests)

    def _execute(
        self,
        progress: Callable[[float], None] | None,
        watch: Callable[[int, Any, Any], None] | None,
        rests: bool,
    ) -> RecordedRun:
        """Execute the plan from where the robot stands, and plans made anew after it."""
        executive, trajectory = self.executive, self.plan.trajectory
        wrench = self._compute_loads()
        planned = rotation_world_body(trajectory.rpy)
        instant_samples = find_instant_samples(self.plan)
        rest_positions = np.full((len(instant_samples), 1 + self.plan.robot.limb_count, 3), np.nan)
        fallen, remaining_time = False, 0.0
        while not fallen and (not executive.finished or (executive.stopped and remaining_time > 0)):
            before = executive.sample
            was_running = not executive.finished
            self._step(wrench)
            sample = executive.sample
            if was_running and executive.stopped:
                remaining_time = _HOLDING_TIME
            remaining_time -= CONTROL_PERIOD
            if sample != before:
                self._record(sample)
                if watch is not None and sample > before:
                    watch(sample, self.model, self.data)
                if progress is not None and sample % 100 == 0:
                    progress(sample / len(trajectory.time))
                for k in np.flatnonzero(instant_samples == sample) if rests else ():
                    rest_positions[k] = self._simulate_rest()
            is_low = trajectory.com[sample, 2] - self.data.qpos[2] > FALLEN
            attitude = self.data.xmat[self.body].reshape(3, 3)
            fallen = bool(is_low or compute_tilt(attitude, planned[sample]) > TUMBLED)
        self._record(executive.sample)
        run = self._build_run(fallen, rest_positions)
        if fallen or not executive.stopped or self.conditions.max_replans < 1:
            return run
        return self._go_on(run, watch)

    def _go_on(
        self, run: RecordedRun, watch: Callable[[int, Any, Any], None] | None
    ) -> RecordedRun:
        """Go on by a plan from the measured stance, if there is one; return the whole run."""
        begin = time.process_time()
        try:
            executive = self.executive.replan()
        except (NoPlanFound, UsageError) as reason:
            stopped = f"{self.executive.stopped}; {str(reason).splitlines()[0]}"
            assert run.execution is not None
            return replace(run, execution=replace(run.execution, stopped=stopped))
        planning_time = time.process_time() - begin
        conditions = replace(self.conditions, max_replans=self.conditions.max_replans - 1)
        second_run = ClosedLoopRun(self.mujoco, self.model, self.data, executive.plan, conditions)
        second_run._take_over(self, executive)
        later = second_run._execute(
            None, None if watch is None else _map_samples(watch, self, second_run), False
        )
        first, following = run.execution, later.execution
        assert first is not None
        assert following is not None
        start = self.executive.time
        events = tuple(event._replace(time=event.time + start) for event in following.events)
        replan = Replan(
            executive.plan, self.executive.stopped, planning_time, float(following.elapsed[-1])
        )
        joined = replace(
            first,
            events=first.events + events,
            stopped=following.stopped,
            step_times=np.concatenate([first.step_times, following.step_times]),
            replans=(replan, *following.replans),
        )
        return replace(run, fallen=later.fallen, execution=joined)

    def _take_over(self, before: ClosedLoopRun, executive: ClimbExecutive) -> None:
        """Go on with an executive where another run has stopped."""
        self.executive = executive
        self._start_clock = before._start_clock + before.executive.clock
        self._start_time = before._start_time + before.executive.time
        self._settling_time = 0.0
        self._loss_begins = before._loss_begins
        # What the robot adds beyond what the executive knows: errors of its footholds
        unknown = self._added[0] - (executive.motor_command - executive.command)
        command = self.data.ctrl[: self.joints].reshape(unknown.shape)
        executive.take_over(command - unknown, before.executive.contacts.force)

    def _step(self, wrench: Array) -> None:
        """Let the executive read sensors and command motors once, and simulate its period."""
        executive, data = self.executive, self.data
        angles, torque = self._read_sensors()
        begin = time.process_time()
        command = executive.step(CONTROL_PERIOD, angles, torque)
        self._step_times.append(time.process_time() - begin)
        sample = executive.sample
        self._lose_friction()
        data.xfrc_applied[self.body] = wrench[sample]
        data.ctrl[: self.joints] = (command + self._added[sample]).ravel()
        self.mujoco.mj_step(self.model, data, nstep=round(CONTROL_PERIOD / TIME_STEP))

    def _lose_friction(self) -> None:
        """Remove friction of toes: losses begin by the plan's clock and last by the robot's."""
        for number, loss in enumerate(self.conditions.losses):
            now = self._start_time + self.executive.time
            if self._start_clock + self.executive.clock >= loss.start:
                self._loss_begins.setdefault(number, now)
            if number in self._loss_begins:
                elapsed = now - self._loss_begins[number]
                self._set_slippery(loss.limb, elapsed < loss.duration)

    def _read_sensors(self) -> tuple[Array, Array]:
        """Read angles (N, J) [rad] and torques (N, J) [N m] as they were before the delay."""
        angles = self._read_angles()
        noise = self._torque_noise * self._sensor_errors.standard_normal(angles.shape)
        torque = self.data.actuator_force[: self.joints].reshape(angles.shape)
        self._readings.append((angles, torque * self._torque_scale + noise))
        delayed = round(self.conditions.delay / CONTROL_PERIOD)
        while len(self._readings) > delayed + 1:
            self._readings.popleft()
        return self._readings[0]

    def _record(self, sample: int) -> None:
        """Record the present state as that of a sample, and of samples skipped before it."""
        del self._rows[sample:]
        elapsed = max(self.executive.time - self._settling_time, 0.0)
        row = self._record_sample(sample) | {"elapsed": elapsed}
        self._rows += [row] * (sample + 1 - len(self._rows))

    def _build_run(self, fallen: bool, rest_positions: Array) -> RecordedRun:
        stacked = {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}
        execution = ExecutionRecord(
            tuple(self.executive.events),
            self.executive.stopped,
            stacked.pop("elapsed"),
            np.array(self._step_times),
        )
        return RecordedRun(
            conditions=self.conditions,
            time=self.plan.trajectory.time[: len(self._rows)],
            fallen=fallen,
            rest_com=rest_positions[:, 0],
            rest_toes=rest_positions[:, 1:],
            grips=None,
            execution=execution,
            **stacked,
        )


def _map_samples(
    watch: Callable[[int, Any, Any], None], before: ClosedLoopRun, after: ClosedLoopRun
) -> Callable[[int, Any, Any], None]:
    """Return `watch` for another plan, whose samples take the place of those that were left."""
    missing = len(before.plan.trajectory.time) - 1 - before.executive.sample
    last = len(after.plan.trajectory.time) - 1

    def watch_rest(sample: int, model: Any, data: Any) -> None:
        watch(before.executive.sample + round(missing * sample / last), model, data)

    return watch_rest
