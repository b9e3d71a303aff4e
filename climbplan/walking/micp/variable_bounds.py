"""Bounds of the variables of a relaxation: interval propagation, and tightened bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.micp.attitude_box import AttitudeBox
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, STATE, VELOCITY, WalkTask


@dataclass(frozen=True)
class BodyRanges:
    """Ranges of the velocity and position of the body, each (N + 1, 3) lower and upper."""

    velocity: tuple[Array, Array]
    position: tuple[Array, Array]


def propagate_body_ranges(task: WalkTask, cutoff: float) -> BodyRanges:
    """Propagate ranges of velocity and position from the start (feasibility-based tightening).

    Tracking of velocity or height alone costs at most the cutoff, and forces within their limits
    bound the acceleration.

    Args:
        task: The task.
        cutoff: Limit on the cost of motions.

    Returns:
        The ranges at all knots.
    """
    knots, dt, body = task.knots, task.dt, task.body
    start = task.start.state
    max_acceleration = body.leg_count * body.force_limit / body.mass
    highest = np.array([max_acceleration, max_acceleration, max_acceleration - body.gravity])
    lowest = np.array([-max_acceleration, -max_acceleration, -body.gravity])
    with np.errstate(divide="ignore"):
        velocity_error = np.sqrt(cutoff / task.weights.velocity)
        height_error = np.sqrt(cutoff / task.weights.height) if task.weights.height else np.inf
    low, high = (np.tile(start[VELOCITY], (knots + 1, 1)) for _ in range(2))
    p_low, p_high = (np.tile(start[POSITION], (knots + 1, 1)) for _ in range(2))
    for n in range(1, knots + 1):
        reference = task.reference.velocity[n - 1]
        low[n] = np.maximum(low[n - 1] + dt * lowest, reference - velocity_error)
        high[n] = np.minimum(high[n - 1] + dt * highest, reference + velocity_error)
        p_low[n] = p_low[n - 1] + dt * low[n - 1]
        p_high[n] = p_high[n - 1] + dt * high[n - 1]
        if n > 1:  # the start decides the first position
            p_low[n, 2] = max(p_low[n, 2], task.reference.height[n - 1] - height_error)
            p_high[n, 2] = min(p_high[n, 2], task.reference.height[n - 1] + height_error)
    return BodyRanges((low, high), (p_low, p_high))


@dataclass(frozen=True)
class VariableBounds:
    """Bounds that every motion of a relaxation satisfies.

    Forces are in the force unit of the relaxation, and about the heading axes as arms are. Bounds
    of the arm and force of a leg hold where it stands.
    """

    state_low: Array  # (N + 1, 12)
    state_high: Array
    velocity_cost: (
        Array  # (2,) upper bound on the cost of velocities along x and y, less their least
    )
    total_force_low: Array  # (N, 3) sum of all contact forces
    total_force_high: Array
    contact_low: Array  # (N, L) 1: the leg stands in every motion
    contact_high: Array  # (N, L) 0: the leg stands in no motion
    arm_low: Array  # (N, L, 2) toe from the body along the heading and across [m]
    arm_high: Array
    force_low: Array  # (N, L, 3)
    force_high: Array

    @classmethod
    def create_open(cls, task: WalkTask, cutoff: float, max_force: float) -> VariableBounds:
        """Return bounds that state only the limit of each force and the cutoff.

        Args:
            task: The task.
            cutoff: Limit on the cost of motions.
            max_force: Limit on each component of a force, in the force unit.
        """
        knots, count = task.knots, task.body.leg_count
        states, legs, sums = (knots + 1, STATE), (knots, count), np.array([-count, -count, 0.0])
        return cls(
            np.full(states, -np.inf),
            np.full(states, np.inf),
            np.full(2, cutoff),
            np.tile(sums * max_force, (knots, 1)),
            np.full((knots, 3), count * max_force),
            np.zeros(legs),
            np.ones(legs),
            np.full((*legs, 2), -np.inf),
            np.full((*legs, 2), np.inf),
            np.tile(sums / count * max_force, (*legs, 1)),
            np.full((*legs, 3), max_force),
        )

    def fix_contacts(self, contact: BoolArray) -> VariableBounds:
        """Return the bounds with all contacts fixed to `contact` (N, L)."""
        value = contact.astype(float)
        return replace(self, contact_low=value, contact_high=value.copy())

    def intersect_attitude_box(self, attitude_box: AttitudeBox) -> AttitudeBox:
        """Return the intersection of an attitude box with the bounds of the states."""
        angles, angles_half = _intersect(
            attitude_box.angles,
            attitude_box.angles_half,
            self.state_low[:, ANGLES],
            self.state_high[:, ANGLES],
        )
        omega, omega_half = _intersect(
            attitude_box.omega,
            attitude_box.omega_half,
            self.state_low[:, SPIN],
            self.state_high[:, SPIN],
        )
        return replace(
            attitude_box,
            angles=angles,
            angles_half=angles_half,
            omega=omega,
            omega_half=omega_half,
        )


def _intersect(middle: Array, half: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return middle and half width of [middle - half, middle + half] within [low, high]."""
    lower, upper = np.maximum(middle - half, low), np.minimum(middle + half, high)
    upper = np.maximum(upper, lower)
    return 0.5 * (lower + upper), 0.5 * (upper - lower)
