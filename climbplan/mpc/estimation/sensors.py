"""What sensors say of a walk that is known: inertial measurements, encoders and contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.mpc.estimation.lie import exponential, logarithm
from climbplan.mpc.task import ANGLES, LEGS, POSITION, VELOCITY, Array, Flags
from climbplan.robots.rotations import rotation_world_body


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations. Nothing is published: all are assumptions, and so said in reports."""

    gyro: float = 0.01  # [rad/s] of each sample
    accelerometer: float = 0.1  # [m/s^2] of each sample
    gyro_bias: float = 1e-3  # [rad/s] at the start, and its walk per square root of a second
    accelerometer_bias: float = 1e-3  # [m/s^2] likewise
    slip: float = 0.01  # [m/s^0.5] random walk of a standing toe
    encoder: float = 0.005  # [m] of a toe seen from the body by forward kinematics
    ground: float = 0.005  # [m] of a standing toe's height over the ground


@dataclass(frozen=True)
class Readings:
    """One sample of all sensors."""

    gyro: Array  # (3,) [rad/s] mean since the last sample, body frame
    accelerometer: Array  # (3,) [m/s^2] mean specific force since the last sample, body frame
    toes: Array  # (4, 3) [m] toes seen from the body, by encoders
    contact: Flags  # (4,) toes on the ground

    def faults(self) -> tuple[str, ...]:
        """What keeps them from being measurements, in words; empty if nothing does."""
        found = [
            f"{name} is not a number"
            for name, values in (
                ("gyro", self.gyro),
                ("accelerometer", self.accelerometer),
                ("a toe", self.toes),
            )
            if not np.isfinite(values).all()
        ]
        return tuple(found)


class Sensors:
    """Sensors with noise and drifting biases on a body whose motion is known."""

    def __init__(self, noise: SensorNoise, gravity: float, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._down = np.array([0.0, 0.0, -gravity])
        self.gyro_bias: Array = noise.gyro_bias * rng.normal(size=3)  # (3,) [rad/s]
        self.accelerometer_bias: Array = noise.accelerometer_bias * rng.normal(size=3)

    def read(self, before: Array, state: Array, toes: Array, contact: Flags, dt: float) -> Readings:
        """Measurements at a state (12,), dt [s] after the state before.

        toes: (4, 3) world frame [m]. Inertial sensors give the mean over the interval, as those
        that integrate within do.
        """
        noise, rng = self._noise, self._rng
        R0, R1 = rotation_world_body(before[ANGLES]), rotation_world_body(state[ANGLES])
        turn = logarithm(R0.T @ R1)
        middle = R0 @ exponential(0.5 * turn)
        felt = middle.T @ ((state[VELOCITY] - before[VELOCITY]) / dt - self._down)
        self.gyro_bias = self.gyro_bias + noise.gyro_bias * np.sqrt(dt) * rng.normal(size=3)
        drift = noise.accelerometer_bias * np.sqrt(dt) * rng.normal(size=3)
        self.accelerometer_bias = self.accelerometer_bias + drift
        return Readings(
            gyro=turn / dt + self.gyro_bias + noise.gyro * rng.normal(size=3),
            accelerometer=felt + self.accelerometer_bias + noise.accelerometer * rng.normal(size=3),
            toes=(toes - state[POSITION]) @ R1 + noise.encoder * rng.normal(size=(LEGS, 3)),
            contact=contact.copy(),
        )
