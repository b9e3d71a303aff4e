"""What the controller is told of body and toes: the truth with noise, or an estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.online.estimation import (
    Beginning,
    ContactFilter,
    Sensed,
    SensorQuality,
    logarithm,
)
from climbplan.walking.online.legs import Stance
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, STATE, VELOCITY, WalkTask


class SimulatedSensors:
    """Noisy samples of a true motion, with biases that drift."""

    def __init__(
        self,
        quality: SensorQuality,
        gravity: float,
        rng: np.random.Generator,
        gyro_bias: float = 0.01,
        accel_bias: float = 0.05,
    ) -> None:
        """gyro_bias [rad/s], accel_bias [m/s^2]: standard deviations of where biases begin."""
        self.quality, self._rng = quality, rng
        self._gravity = np.array([0.0, 0.0, -gravity])
        self.gyro_bias: Array = gyro_bias * rng.normal(size=3)
        self.accel_bias: Array = accel_bias * rng.normal(size=3)

    def sample(
        self, before: Array, after: Array, toes: Array, contact: BoolArray, dt: float
    ) -> Sensed:
        """Between two states (12,), dt apart; toes (L, 3) in the world at the second.

        The IMU integrates: its means are exact but for noise, bias and range.
        """
        quality, rng = self.quality, self._rng
        self.gyro_bias = self.gyro_bias + quality.gyro_drift * np.sqrt(dt) * rng.normal(size=3)
        self.accel_bias = self.accel_bias + quality.accel_drift * np.sqrt(dt) * rng.normal(size=3)
        R, R_after = rotation_world_body(before[ANGLES]), rotation_world_body(after[ANGLES])
        spin = logarithm(R.T @ R_after) / dt
        force = R.T @ ((after[VELOCITY] - before[VELOCITY]) / dt - self._gravity)
        gyro = spin + self.gyro_bias + quality.gyro * rng.normal(size=3)
        accel = force + self.accel_bias + quality.accel * rng.normal(size=3)
        accel = np.clip(accel, -quality.accel_range, quality.accel_range)
        seen = (toes - after[POSITION]) @ R_after + quality.toe * rng.normal(size=toes.shape)
        rate = after[SPIN] @ R_after + self.gyro_bias + quality.gyro * rng.normal(size=3)
        return Sensed(gyro, accel, seen, contact.copy(), rate, self._rates(after, toes, R_after))

    def _rates(self, after: Array, toes: Array, R: Array) -> Array | None:
        """Velocities (L, 3) in the body of toes that stay where they are; None without sensors."""
        deviation = self.quality.toe_rate
        if deviation == 0:
            return None
        here = (toes - after[POSITION]) @ R
        rates: Array = -after[VELOCITY] @ R - np.cross(after[SPIN] @ R, here)
        return rates + deviation * self._rng.normal(size=toes.shape)


_LISTENING = 2.0  # [s]


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what the controller is told without an estimator."""

    velocity: float = 0.0  # [m/s]
    angles: float = 0.0  # [rad]
    spin: float = 0.0  # [rad/s]
    position: float = 0.0  # [m] of height and of toes against the body


class Perception:
    """Of one run; the estimator is fed with simulated sensors."""

    def __init__(
        self,
        task: WalkTask,
        state: Array,
        noise: Noise,
        quality: SensorQuality | None,
        rng: np.random.Generator,
    ) -> None:
        self._noise, self._rng = noise, rng
        self._filter: ContactFilter | None = None
        self._sensed: Sensed | None = None
        if quality is not None:
            gravity = task.body.gravity
            self._filter = ContactFilter(Beginning(state), quality, gravity, task.body.leg_count)
            self._sensors = SimulatedSensors(quality, gravity, rng)

    def listen(self, state: Array, toes: Array, dt: float) -> None:
        """Stand still before the walk: the gyroscope's bias shows, and most of the tilt."""
        if not state[VELOCITY].any() and not state[SPIN].any():
            for _ in range(round(_LISTENING / dt)):
                self.feel(state, state, toes, np.ones(len(toes), bool), dt)

    def feel(self, before: Array, after: Array, toes: Array, contact: BoolArray, dt: float) -> None:
        """A sample of the sensors; toes (L, 3) in the world after it."""
        if self._filter is not None:
            self._sensed = self._sensors.sample(before, after, toes, contact, dt)
            self._filter.predict(self._sensed, dt)
            self._filter.correct(self._sensed)

    def acceleration(self, before: Array, after: Array, dt: float) -> Array:
        """Of the body (3,) over the last sample, world frame: as felt, or the true one [m/s^2]."""
        if self._filter is None or self._sensed is None:
            true: Array = (after[VELOCITY] - before[VELOCITY]) / dt
            return true
        found = self._filter
        felt: Array = found.R @ (self._sensed.accel - found.accel_bias) + found.gravity
        return felt

    @property
    def speed_error(self) -> float:
        """Standard deviation of the velocity that is told, of its worst component [m/s]."""
        if self._filter is None:
            return 0.0
        return self._filter.speed_error

    def state_and_toes(self, state: Array, stance: Stance) -> tuple[Array, Array]:
        """The state (12,), and where legs stand (L, 3); heights are above the ground."""
        if self._filter is None or self._sensed is None:
            return self._noisy(state, stance.toes)
        found, sensed = self._filter, self._sensed
        told = np.empty(STATE)
        told[POSITION], told[VELOCITY] = found.p, found.v
        R = found.R
        told[ANGLES] = [
            np.arctan2(R[2, 1], R[2, 2]),
            np.arcsin(np.clip(-R[2, 0], -1.0, 1.0)),
            np.arctan2(R[1, 0], R[0, 0]),
        ]
        told[SPIN] = R @ (sensed.rate - found.gyro_bias)
        toes = found.toes(sensed)
        # The ground is where feet stand: where the world's zero is cannot be observed.
        if found.standing.any():
            told[2] -= toes[found.standing, 2].mean()
        return told, toes * [1.0, 1.0, 0.0]

    def _noisy(self, state: Array, toes: Array) -> tuple[Array, Array]:
        noise, rng = self._noise, self._rng
        off = np.zeros(STATE)
        off[2] = noise.position * rng.normal()
        off[VELOCITY] = noise.velocity * rng.normal(size=3)
        off[ANGLES] = noise.angles * rng.normal(size=3)
        off[SPIN] = noise.spin * rng.normal(size=3)
        shift = np.zeros_like(toes)
        shift[:, :2] = noise.position * rng.normal(size=(len(toes), 2))
        return state + off, toes + shift
