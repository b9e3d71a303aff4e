"""Joint speeds of standing and swinging legs along a walk, by inverse kinematics.

Only robots from URDFs have them: their plans carry joints, bounds and speed limits. Between knots
the body follows Hermite cubics of positions, velocities, angles and their rates. Toes stand, or
follow the swing trajectory from where they lifted to where they land. Speeds are means over a
sixteenth of an interval, of 5 ms at least. Swings that end after the plan are not checked, as their
landing is not stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.check.reference_dynamics import euler_rates
from climbplan.walking.plan.swing_trajectory import quartic_arch, quintic_progress
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, WalkTask, WalkTrajectory

_MAX_SAMPLES = 16  # of an interval
_MIN_SAMPLE_TIME = 0.005  # [s]


@dataclass(frozen=True)
class LegSpeeds:
    """Joint speeds and missing reach of each interval and leg."""

    missing: Array  # (N, L) [m] by which joints do not get a swinging toe along its way
    speed: Array  # (N, L, J) largest [rad/s], [m/s] of joints that slide


def compute_leg_speeds(legs: WalkingLegs, task: WalkTask, trajectory: WalkTrajectory) -> LegSpeeds:
    """Return the joint speeds that body and toes require of all legs."""
    step = task.dt
    num_samples = int(np.clip(round(step / _MIN_SAMPLE_TIME), 1, _MAX_SAMPLES))
    phase = np.linspace(0.0, 1.0, num_samples + 1)
    toes, swings = _build_toe_paths(task, trajectory, phase)
    spots = _transform_to_body(trajectory.state, step, phase, toes)
    is_judged = trajectory.gait.contact[:-1] | swings  # (N, L)
    rest_toes = legs.chain.joint_points(legs.chain.posture)[:, -1]
    solution = legs.chain.inverse(
        np.where(is_judged[:, None, :, None], spots, rest_toes), legs.lower, legs.upper
    )
    angles = solution.angles[..., 0, :, :]  # (N, K + 1, L, J)
    speed = np.abs(np.diff(angles, axis=1)).max(axis=1) * num_samples / step
    missing = solution.missing[..., 0, :].max(axis=1)
    return LegSpeeds(np.where(swings, missing, 0.0), np.where(is_judged[..., None], speed, 0.0))


def generate_speed_residuals(
    task: WalkTask, trajectory: WalkTrajectory
) -> Iterator[tuple[str, Array, Array]]:
    """Yield names of checks, residuals and fractions of limits (N, L); none without joints."""
    if task.legs is None:
        return
    speeds = compute_leg_speeds(task.legs, task, trajectory)
    yield "swing.reach", speeds.missing, np.zeros_like(speeds.missing)
    excess = (speeds.speed - task.legs.max_speed).max(axis=2)
    yield "speed.limit", excess, (speeds.speed / task.legs.max_speed).max(axis=2)


def _build_toe_paths(
    task: WalkTask, trajectory: WalkTrajectory, phase: Array
) -> tuple[Array, BoolArray]:
    """Return the toes within intervals, and which of them swing to a landing.

    Args:
        task: The task.
        trajectory: The trajectory.
        phase: Fractions of an interval (K + 1,).

    Returns:
        Toes (N, K + 1, L, 3), world frame [m], and swings (N, L).
    """
    contact, stance_toes = trajectory.gait.contact, trajectory.toes
    toes = np.repeat(stance_toes[:-1, None], len(phase), axis=1)
    swings = np.zeros_like(contact[:-1])
    for leg in range(contact.shape[1]):
        change = np.diff(np.concatenate([[True], contact[:, leg]]).astype(np.int8))
        for lift_knot in np.flatnonzero(change < 0).tolist():
            landing_offsets = np.flatnonzero(contact[lift_knot:, leg])
            if not len(landing_offsets):
                continue
            landing_knot = lift_knot + int(landing_offsets[0])
            lift_off, landing = (
                stance_toes[max(lift_knot - 1, 0), leg],
                stance_toes[landing_knot, leg],
            )
            apex = max(
                stance_toes[lift_knot:landing_knot, leg, 2].max(),
                max(lift_off[2], landing[2]) + task.swing_clearance,
            )
            s = (np.arange(landing_knot - lift_knot)[:, None] + phase) / (landing_knot - lift_knot)
            path = lift_off + quintic_progress(s)[0][..., None] * (landing - lift_off)
            path[..., 2] += quartic_arch(s)[0] * (apex - 0.5 * (lift_off[2] + landing[2]))
            toes[lift_knot:landing_knot, :, leg] = path
            swings[lift_knot:landing_knot, leg] = True
    return toes, swings


def _transform_to_body(state: Array, step: float, phase: Array, toes: Array) -> Array:
    """Return toes (N, K + 1, L, 3) in the moving body frame."""
    rates = euler_rates(state[:, ANGLES], state[:, SPIN])
    position = _interpolate_hermite(state[:, POSITION], state[:, VELOCITY], step, phase)
    R = rotation_world_body(_interpolate_hermite(state[:, ANGLES], rates, step, phase))
    spots: Array = (toes - position[:, :, None]) @ R
    return spots


def _interpolate_hermite(value: Array, rate: Array, step: float, phase: Array) -> Array:
    """Return Hermite cubics (N, K + 1, 3) through values and rates (N + 1, 3)."""
    s = phase[None, :, None]
    first, second = value[:-1, None], value[1:, None]
    begin, end = step * rate[:-1, None], step * rate[1:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * first
        + s * (1 - s) ** 2 * begin
        + s**2 * (3 - 2 * s) * second
        - s**2 * (1 - s) * end
    )
