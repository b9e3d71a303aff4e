"""The state feedback of the controller: the true state with noise, or the estimate of the EKF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.online.estimation import (
    ContactAidedEkf,
    InitialEstimate,
    SensorQuality,
    SensorSample,
    logarithm,
)
from climbplan.walking.online.stance import ToeStance
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, STATE, VELOCITY, WalkTask


class SimulatedSensors:
    """Simulated IMU, encoders and contact switches with noise and drifting biases."""

    def __init__(
        self,
        quality: SensorQuality,
        gravity: float,
        rng: np.random.Generator,
        gyro_bias: float = 0.01,
        accel_bias: float = 0.05,
    ) -> None:
        """Draw the initial biases.

        Args:
            quality: noise and drifts.
            gravity: magnitude of the gravitational acceleration [m/s^2].
            rng: source of all noise.
            gyro_bias: standard deviation of the gyroscope's initial bias [rad/s].
            accel_bias: standard deviation of the accelerometer's initial bias [m/s^2].
        """
        self.quality, self._rng = quality, rng
        self._gravity = np.array([0.0, 0.0, -gravity])
        self.gyro_bias: Array = gyro_bias * rng.normal(size=3)
        self.accel_bias: Array = accel_bias * rng.normal(size=3)

    def sample(
        self, previous_state: Array, state: Array, toes: Array, contact: BoolArray, dt: float
    ) -> SensorSample:
        """Sample the sensors over one interval.

        The IMU integrates: its means are exact except for noise, bias and range.

        Args:
            previous_state: (12,) state at the beginning of the interval.
            state: (12,) state at its end.
            toes: (L, 3) world positions at its end [m].
            contact: (L,) legs in contact.
            dt: length of the interval [s].
        """
        quality, rng = self.quality, self._rng
        self.gyro_bias = self.gyro_bias + quality.gyro_drift * np.sqrt(dt) * rng.normal(size=3)
        self.accel_bias = self.accel_bias + quality.accel_drift * np.sqrt(dt) * rng.normal(size=3)
        R, R_after = rotation_world_body(previous_state[ANGLES]), rotation_world_body(state[ANGLES])
        angular_velocity = logarithm(R.T @ R_after) / dt
        specific_force = R.T @ ((state[VELOCITY] - previous_state[VELOCITY]) / dt - self._gravity)
        gyro = angular_velocity + self.gyro_bias + quality.gyro * rng.normal(size=3)
        accel = specific_force + self.accel_bias + quality.accel * rng.normal(size=3)
        accel = np.clip(accel, -quality.accel_range, quality.accel_range)
        toe_positions = (toes - state[POSITION]) @ R_after + quality.toe * rng.normal(
            size=toes.shape
        )
        angular_rate = state[SPIN] @ R_after + self.gyro_bias + quality.gyro * rng.normal(size=3)
        return SensorSample(
            gyro,
            accel,
            toe_positions,
            contact.copy(),
            angular_rate,
            self._sample_toe_velocities(state, toes, R_after),
        )

    def _sample_toe_velocities(self, state: Array, toes: Array, R: Array) -> Array | None:
        """Return body-frame velocities (L, 3) of resting toes; None without such sensors."""
        deviation = self.quality.foot_velocity_std
        if deviation == 0:
            return None
        toes_body = (toes - state[POSITION]) @ R
        velocities: Array = -state[VELOCITY] @ R - np.cross(state[SPIN] @ R, toes_body)
        return velocities + deviation * self._rng.normal(size=toes.shape)


_CALIBRATION_TIME = 2.0  # [s]


@dataclass(frozen=True)
class StateNoise:
    """Standard deviations of the state feedback where there is no estimator."""

    velocity: float = 0.0  # [m/s]
    angles: float = 0.0  # [rad]
    spin: float = 0.0  # [rad/s]
    position: float = 0.0  # [m] of height and of toes against the body


class StateFeedback:
    """The state feedback of one run; an estimator is fed by simulated sensors."""

    def __init__(
        self,
        task: WalkTask,
        state: Array,
        noise: StateNoise,
        quality: SensorQuality | None,
        rng: np.random.Generator,
    ) -> None:
        self._noise, self._rng = noise, rng
        self._ekf: ContactAidedEkf | None = None
        self._last_sample: SensorSample | None = None
        if quality is not None:
            gravity = task.body.gravity
            self._ekf = ContactAidedEkf(
                InitialEstimate(state), quality, gravity, task.body.leg_count
            )
            self._sensors = SimulatedSensors(quality, gravity, rng)

    def calibrate_at_rest(self, state: Array, toes: Array, dt: float) -> None:
        """Let the filter converge at rest before the walk.

        Standing still makes the gyroscope's bias and most of the tilt observable.
        """
        if not state[VELOCITY].any() and not state[SPIN].any():
            for _ in range(round(_CALIBRATION_TIME / dt)):
                self.process_sample(state, state, toes, np.ones(len(toes), bool), dt)

    def process_sample(
        self, previous_state: Array, state: Array, toes: Array, contact: BoolArray, dt: float
    ) -> None:
        """Pass one sensor sample to the filter; toes (L, 3) in the world at its end."""
        if self._ekf is not None:
            self._last_sample = self._sensors.sample(previous_state, state, toes, contact, dt)
            self._ekf.predict(self._last_sample, dt)
            self._ekf.update(self._last_sample)

    def measure_acceleration(self, previous_state: Array, state: Array, dt: float) -> Array:
        """Return the body's acceleration (3,) over the last sample, world frame [m/s^2].

        It is the accelerometer's with an estimator, else the true one.
        """
        if self._ekf is None or self._last_sample is None:
            exact: Array = (state[VELOCITY] - previous_state[VELOCITY]) / dt
            return exact
        ekf = self._ekf
        measured: Array = ekf.R @ (self._last_sample.accel - ekf.accel_bias) + ekf.gravity
        return measured

    @property
    def velocity_std(self) -> float:
        """Largest standard deviation of a component of the fed-back velocity [m/s]."""
        if self._ekf is None:
            return 0.0
        return self._ekf.velocity_std

    def read_state_and_toes(self, state: Array, stance: ToeStance) -> tuple[Array, Array]:
        """Return the fed-back state (12,) and toes (L, 3); a filter has heights above ground."""
        if self._ekf is None or self._last_sample is None:
            return self._perturb_state(state, stance.toes)
        ekf, sample = self._ekf, self._last_sample
        estimate = np.empty(STATE)
        estimate[POSITION], estimate[VELOCITY] = ekf.p, ekf.v
        R = ekf.R
        estimate[ANGLES] = [
            np.arctan2(R[2, 1], R[2, 2]),
            np.arcsin(np.clip(-R[2, 0], -1.0, 1.0)),
            np.arctan2(R[1, 0], R[0, 0]),
        ]
        estimate[SPIN] = R @ (sample.angular_rate - ekf.gyro_bias)
        toes = ekf.compute_toes(sample)
        # Absolute height is unobservable: heights are measured from the standing feet.
        if ekf.standing.any():
            estimate[2] -= toes[ekf.standing, 2].mean()
        return estimate, toes * [1.0, 1.0, 0.0]

    def _perturb_state(self, state: Array, toes: Array) -> tuple[Array, Array]:
        """Return state (12,) and toes (L, 3) with noise on both."""
        noise, rng = self._noise, self._rng
        error = np.zeros(STATE)
        error[2] = noise.position * rng.normal()
        error[VELOCITY] = noise.velocity * rng.normal(size=3)
        error[ANGLES] = noise.angles * rng.normal(size=3)
        error[SPIN] = noise.spin * rng.normal(size=3)
        toe_error = np.zeros_like(toes)
        toe_error[:, :2] = noise.position * rng.normal(size=(len(toes), 2))
        return state + error, toes + toe_error
