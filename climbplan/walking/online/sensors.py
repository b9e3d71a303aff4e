"""What an IMU, encoders and contact sensors on the simulated body would say."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.online.estimation import Sensed, SensorQuality, logarithm
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY


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
