"""Joint speeds of standing and swinging legs along a walk, by inverse kinematics.

Of robots from URDFs alone: their plans carry joints, bounds and speed limits. Between samples the
body moves as positions, velocities, angles and their rates at both ends say (cubics); toes stand,
or are on their ways (`swing_way.py`) from where they lifted to where they land, at mid-way as high
as the plan lifts them. Speeds are means over a sixteenth of an interval, of 5 ms at least. Ways
that end after the plan are not judged: where they lead is not stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.check.truth import euler_rates
from climbplan.walking.plan.swing_way import along, arch
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY, WalkTask, WalkTrajectory

_PARTS = 16  # of an interval
_FINEST = 0.005  # [s]


@dataclass(frozen=True)
class LegSpeeds:
    """Of each interval and leg (N, L)."""

    missing: Array  # (N, L) [m] by which joints do not get a swinging toe along its way
    speed: Array  # (N, L, J) largest [rad/s], [m/s] of joints that slide


def leg_speeds(legs: WalkingLegs, task: WalkTask, found: WalkTrajectory) -> LegSpeeds:
    """What body and toes ask of the joints of all legs."""
    step = task.step
    parts = int(np.clip(round(step / _FINEST), 1, _PARTS))
    share = np.linspace(0.0, 1.0, parts + 1)
    toes, swings = _ways(task, found, share)
    spots = _seen(found.state, step, share, toes)
    judged = found.gait.contact[:-1] | swings  # (N, L)
    rest = legs.chain.joint_points(legs.chain.posture)[:, -1]
    solution = legs.chain.inverse(
        np.where(judged[:, None, :, None], spots, rest), legs.lower, legs.upper
    )
    angles = solution.angles[..., 0, :, :]  # (N, K + 1, L, J)
    speed = np.abs(np.diff(angles, axis=1)).max(axis=1) * parts / step
    missing = solution.missing[..., 0, :].max(axis=1)
    return LegSpeeds(np.where(swings, missing, 0.0), np.where(judged[..., None], speed, 0.0))


def speed_residuals(task: WalkTask, found: WalkTrajectory) -> Iterator[tuple[str, Array, Array]]:
    """Names of checks, residuals and shares of limits (N, L); nothing of bodies without joints."""
    if task.legs is None:
        return
    speeds = leg_speeds(task.legs, task, found)
    yield "swing.reach", speeds.missing, np.zeros_like(speeds.missing)
    beyond = (speeds.speed - task.legs.max_speed).max(axis=2)
    yield "speed.limit", beyond, (speeds.speed / task.legs.max_speed).max(axis=2)


def _ways(task: WalkTask, found: WalkTrajectory, share: Array) -> tuple[Array, BoolArray]:
    """Toes (N, K + 1, L, 3) at shares (K + 1,) of intervals; which swing to where they land."""
    contact, stood = found.gait.contact, found.toes
    toes = np.repeat(stood[:-1, None], len(share), axis=1)
    swings = np.zeros_like(contact[:-1])
    for leg in range(contact.shape[1]):
        change = np.diff(np.concatenate([[True], contact[:, leg]]).astype(np.int8))
        for lifts in np.flatnonzero(change < 0).tolist():
            after = np.flatnonzero(contact[lifts:, leg])
            if not len(after):
                continue
            lands = lifts + int(after[0])
            left, there = stood[max(lifts - 1, 0), leg], stood[lands, leg]
            top = max(stood[lifts:lands, leg, 2].max(), max(left[2], there[2]) + task.lift)
            s = (np.arange(lands - lifts)[:, None] + share) / (lands - lifts)
            way = left + along(s)[0][..., None] * (there - left)
            way[..., 2] += arch(s)[0] * (top - 0.5 * (left[2] + there[2]))
            toes[lifts:lands, :, leg] = way
            swings[lifts:lands, leg] = True
    return toes, swings


def _seen(state: Array, step: float, share: Array, toes: Array) -> Array:
    """Toes (N, K + 1, L, 3) of the world in the body, that moves on from sample to sample."""
    rates = euler_rates(state[:, ANGLES], state[:, SPIN])
    place = _between(state[:, POSITION], state[:, VELOCITY], step, share)
    R = rotation_world_body(_between(state[:, ANGLES], rates, step, share))
    spots: Array = (toes - place[:, :, None]) @ R
    return spots


def _between(value: Array, rate: Array, step: float, share: Array) -> Array:
    """Hermite's cubics (N, K + 1, 3) through values and rates (N + 1, 3)."""
    s = share[None, :, None]
    one, other = value[:-1, None], value[1:, None]
    begin, end = step * rate[:-1, None], step * rate[1:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * one
        + s * (1 - s) ** 2 * begin
        + s**2 * (3 - 2 * s) * other
        - s**2 * (1 - s) * end
    )
