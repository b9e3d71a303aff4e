"""The measurement that the controller receives at a tick, and its plausibility checks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.task.task import POSITION, SPIN, VELOCITY, RigidBody

MAX_AGE = 0.1  # [s] of a usable measurement
_MAX_SPEED = 8.0  # [m/s] of a plausible state
_MAX_ANGULAR_RATE = 25.0  # [rad/s]
_MAX_TILT = 1.4  # [rad]
_HEIGHT_RANGE = (0.02, 2.0)  # [m] of the body above the ground
_MAX_TOE_DISTANCE = 2.0  # [m] of a toe from the body


@dataclass(frozen=True)
class TickInput:
    """The controller's input at a tick: the body's state, its toes, and the recent contacts."""

    state: Array  # (12,) position, velocity, Euler angles, angular velocity; world frame
    toes: Array  # (L, 3) world [m]
    previous_toes: Array  # (L, 3) one knot earlier
    previous_contact: BoolArray  # (L,) from one knot earlier until now
    age: float = 0.0  # [s] since the measurement, without the time bridged by prediction
    undetected_contacts: tuple[int, ...] = ()  # legs in planned stance without detected contact
    time_to_knot: float = 0.0  # [s] if the plan begins between knots, else 0
    # [s] a shorter first interval, allowed where no plan is feasible; 0: none
    short_interval: float = 0.0
    airborne: BoolArray | None = None  # (L,) legs in the air until the next knot; None: none

    @property
    def position(self) -> Array:
        """Centre of mass (3,), world frame [m]."""
        return self.state[POSITION]

    @property
    def velocity(self) -> Array:
        """Velocity (3,) of the centre of mass, world frame [m/s]."""
        return self.state[VELOCITY]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity (3,) of the body, world frame [rad/s]."""
        return self.state[SPIN]

    @property
    def tilt(self) -> Array:
        """Roll and pitch (2,) [rad]."""
        return self.state[6:8]


def detect_fault(measurement: TickInput, body: RigidBody) -> str:
    """Return why a measurement is implausible or unusable; an empty string if it can be used."""
    arrays = (measurement.state, measurement.toes, measurement.previous_toes)
    legs = body.leg_count
    shapes = ((12,), (legs, 3), (legs, 3))
    if any(array.shape != shape for array, shape in zip(arrays, shapes, strict=True)):
        return "the measurement has another shape"
    values = np.concatenate([array.ravel() for array in arrays])
    if not np.isfinite(values).all() or not np.isfinite(measurement.age):
        return "the measurement is not a number"
    if measurement.age > MAX_AGE:
        return f"the measurement is {1e3 * measurement.age:.0f} ms old"
    rate = np.abs(measurement.angular_velocity).max()
    if np.abs(measurement.velocity).max() > _MAX_SPEED or rate > _MAX_ANGULAR_RATE:
        return "the measured speed is impossible"
    if not _HEIGHT_RANGE[0] < measurement.position[2] < _HEIGHT_RANGE[1]:
        return "the measured height is impossible"
    if np.abs(measurement.tilt).max() > _MAX_TILT:
        return "the measured tilt leaves no way to stand"
    if np.abs(measurement.toes - measurement.position).max() > _MAX_TOE_DISTANCE:
        return "the measured toes are nowhere near the body"
    if 2 * len(measurement.undetected_contacts) > legs:
        names = ", ".join(body.leg_names[leg] for leg in measurement.undetected_contacts)
        return f"{names} make no contact"
    return ""
