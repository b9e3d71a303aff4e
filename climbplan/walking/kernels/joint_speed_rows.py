"""Joint speeds of standing and swinging legs as rows on states and footholds, compiled.

The joint speed is dq/dt = J^+ R' (dx/dt - v - w x (x - p)), of a toe at x and a body at p with
velocity v and angular velocity w. J, R and x - p are those of the point of linearisation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.joint_torque_rows import select_leg, solve_leg_jacobian
from climbplan.walking.kernels.parameters import (
    AffineStates,
    FootholdUnknowns,
    LegChain,
    QpRows,
    SteppingMotion,
)

NUM_SWING_SAMPLES = 9  # in each interval of a swing
_FIRST_SAMPLE, _SAMPLE_SPACING = 0.1, 0.1  # fractions of the interval
_MIN_SPEED_FRACTION = 0.5  # of the limit, below which a speed has no row
_DAMPING = 1e-8  # of the Jacobian's squared norm


class IntervalTime(NamedTuple):
    """A time within an interval."""

    interval: int
    fraction: float
    step: float  # length of the interval [s]


@compiled
def _invert_jacobian(jacobian: Array, R: Array, inverse: Array) -> None:
    """Write the damped pseudo-inverse J^+ R' (J, 3) of a Jacobian (3, J)."""
    square = jacobian @ jacobian.T
    damping = _DAMPING * (square[0, 0] + square[1, 1] + square[2, 2])
    for i in range(3):
        square[i, i] += damping
    inverse[:] = jacobian.T @ np.linalg.solve(square, np.ascontiguousarray(R.T))


@compiled
def _interpolate_body(state: Array, time: IntervalTime, position: Array, angles: Array) -> None:
    """Write position (3,) and angles (3,) of the body, by cubic Hermite interpolation."""
    n, u, step = time.interval, time.fraction, time.step
    first, last = u * (1.0 - u) ** 2 * step, -(u**2) * (1.0 - u) * step
    blend = u**2 * (3.0 - 2.0 * u)
    for k in range(3):
        position[k] = (1.0 - blend) * state[n, k] + blend * state[n + 1, k]
        position[k] += first * state[n, 3 + k] + last * state[n + 1, 3 + k]
        angles[k] = (1.0 - blend) * state[n, 6 + k] + blend * state[n + 1, 6 + k]
    for m, weight in ((n, first), (n + 1, last)):
        sp, cp = np.sin(state[m, 7]), np.cos(state[m, 7])
        sy, cy = np.sin(state[m, 8]), np.cos(state[m, 8])
        roll = (cy * state[m, 9] + sy * state[m, 10]) / cp
        angles[0] += weight * roll
        angles[1] += weight * (cy * state[m, 10] - sy * state[m, 9])
        angles[2] += weight * (state[m, 11] + sp * roll)


@compiled
def _add_body_velocity(
    g: Array, arm: Array, angles: Array, time: IntervalTime, states: AffineStates, row: Array
) -> float:
    """Add g' (-v - w x arm) to a row (Z,) and return its constant.

    v and w are the body's rates at a time, of the cubics through both knots of the interval.
    """
    n, u, step = time.interval, time.fraction, time.step
    offset, sensitivity = states.offset, states.sensitivity
    turn = np.empty(3)  # g' (-w x arm) = w' (g x arm)
    turn[0] = g[1] * arm[2] - g[2] * arm[1]
    turn[1] = g[2] * arm[0] - g[0] * arm[2]
    turn[2] = g[0] * arm[1] - g[1] * arm[0]
    sp, cp, sy, cy = np.sin(angles[1]), np.cos(angles[1]), np.sin(angles[2]), np.cos(angles[2])
    euler = np.empty(3)  # the same by rates of roll, pitch, yaw
    euler[0] = cp * (cy * turn[0] + sy * turn[1]) - sp * turn[2]
    euler[1] = cy * turn[1] - sy * turn[0]
    euler[2] = turn[2]
    difference = 6.0 * u * (1.0 - u) / step
    constant = 0.0
    for m, rate, value in (
        (n, 1.0 - 4.0 * u + 3.0 * u**2, -difference),
        (n + 1, 3.0 * u**2 - 2.0 * u, difference),
    ):
        for first, weight, each in (
            (0, -value, g), (3, -rate, g), (6, value, euler), (9, rate, turn),
        ):  # fmt: skip
            if weight == 0.0:
                continue
            for k in range(3):
                factor = weight * each[k]
                constant += factor * offset[m, first + k]
                source = sensitivity[m, first + k]
                for c in range(row.shape[0]):
                    row[c] += factor * source[c]
    return constant


class SwingInterval(NamedTuple):
    """The swing, or the stance, of a leg that an interval belongs to."""

    leg: int
    interval: int
    left: int  # knot of the last stance before
    lands: int  # knot of the landing; N + 1 beyond the horizon
    span: float  # [s] duration of the swing
    elapsed: float  # [s] before the interval
    high: float  # [m] of the quartic profile above the mean of both ends


@compiled
def _find_swing(motion: SteppingMotion, leg: int, n: int) -> SwingInterval:
    """Find the swing or stance of a leg that interval n belongs to."""
    contact, toes, steps = motion.contact, motion.toes, motion.steps
    knots = contact.shape[0]
    lifts, lands = n, n
    while lifts > 0 and not contact[lifts - 1, leg]:
        lifts -= 1
    while lands < knots and not contact[lands, leg]:
        lands += 1
    left = n if contact[n, leg] else max(lifts - 1, 0)
    if lands == knots:
        return SwingInterval(leg, n, left, lands, 0.0, 0.0, 0.0)
    span, elapsed = 0.0, 0.0
    top = max(toes[left, leg, 2], toes[lands, leg, 2]) + motion.swing_clearance
    for m in range(lifts, lands):
        span += steps[m]
        elapsed += steps[m] if m < n else 0.0
        top = max(top, toes[m, leg, 2])
    high = top - 0.5 * (toes[left, leg, 2] + toes[lands, leg, 2])
    return SwingInterval(leg, n, left, lands, span, elapsed, high)


@compiled
def _sample_toe(
    motion: SteppingMotion, swing: SwingInterval, sample: int, toe: Array, velocity: Array
) -> tuple[float, float]:
    """Write a toe (3,) and its velocity (3,) at a sample of an interval.

    Returns:
        The fraction of the interval, and the rate of the swing's progress [1/s].
    """
    toes, leg, left, lands = motion.toes, swing.leg, swing.left, swing.lands
    u, rate = float(sample), 0.0
    velocity[:] = 0.0
    toe[:] = toes[left, leg]
    if not motion.contact[swing.interval, leg]:
        u = _FIRST_SAMPLE + _SAMPLE_SPACING * sample
        s = (swing.elapsed + u * motion.steps[swing.interval]) / swing.span
        progress = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / swing.span
        for k in range(3):
            across = toes[lands, leg, k] - toes[left, leg, k]
            toe[k] += progress * across
            velocity[k] = rate * across
        toe[2] += 16.0 * s**2 * (1.0 - s) ** 2 * swing.high
        velocity[2] += 32.0 * s * (1.0 - s) * (1.0 - 2.0 * s) * swing.high / swing.span
    return u, rate


@compiled
def _add_foothold_velocity(
    g: Array,
    rate: float,
    swing: SwingInterval,
    footholds: FootholdUnknowns,
    row: Array,
    constant: float,
) -> float:
    """Add the effect of a swing's ends on g' dx/dt to a row (Z,); return its updated constant."""
    for knot, sign in ((swing.left, -rate), (swing.lands, rate)):
        index = footholds.foothold[knot, swing.leg]
        if index < 0:  # the toe stands where it stood at the start
            continue
        for k in range(2):
            by_spot = sign * (g[k] + g[2] * footholds.tilt[index, k])
            row[footholds.first_column + 2 * index + k] += by_spot * footholds.unit
            constant -= by_spot * footholds.spots[index, k]
    return constant


@compiled
def write_speed_rows(
    chains: LegChain,
    max_speed: Array,
    motion: SteppingMotion,
    footholds: FootholdUnknowns,
    states: AffineStates,
    block: QpRows,
) -> int:
    """Write joint speed limits as rows on states and footholds; return the number of rows.

    Standing legs have rows at both ends of an interval. Swinging legs have rows at
    `NUM_SWING_SAMPLES` fractions of each interval of a swing that lands within the horizon.
    There are J (2 F + samples S) rows at most. Speeds far from their limits have none, and legs out
    of reach have none, as their workspace rows are violated anyway.

    Args:
        chains: all legs, arrays with a first axis (L,).
        max_speed: (L, J) speed limits, the units of the rows [rad/s].
        motion: point of linearisation.
        footholds, states: free footholds, and states by unknowns.
        block: output.
    """
    contact = motion.contact
    knots, legs = contact.shape
    joints = chains.joint.shape[1]
    R, jacobian, g = np.empty((3, 3)), np.empty((3, joints)), np.empty((joints, 3))
    position, arm, angles, velocity = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    # The motion itself as states without unknowns
    no_row, fixed = np.empty(0), AffineStates(motion.state, np.empty((knots, 12, 0)))
    count = 0
    for leg in range(legs):
        chain = select_leg(chains, leg)
        for n in range(knots - 1):
            swing = _find_swing(motion, leg, n)
            if swing.lands == knots:
                continue
            for sample in range(2 if contact[n, leg] else NUM_SWING_SAMPLES):
                u, rate = _sample_toe(motion, swing, sample, arm, velocity)
                time = IntervalTime(n, u, motion.steps[n])
                _interpolate_body(motion.state, time, position, angles)
                arm -= position
                rotation(angles, R)
                if not solve_leg_jacobian(chain, R.T @ arm, jacobian):
                    continue
                _invert_jacobian(jacobian, R, g)
                for j in range(joints):
                    g[j] /= max_speed[leg, j]
                    constant = g[j] @ velocity
                    speed = constant + _add_body_velocity(g[j], arm, angles, time, fixed, no_row)
                    if abs(speed) < _MIN_SPEED_FRACTION:
                        continue
                    row = block.rows[count]
                    row[:] = 0.0
                    constant += _add_body_velocity(g[j], arm, angles, time, states, row)
                    if not contact[n, leg]:
                        constant = _add_foothold_velocity(
                            g[j], rate, swing, footholds, row, constant
                        )
                    block.lower[count], block.upper[count] = -1.0 - constant, 1.0 - constant
                    count += 1
    return count


@compiled
def count_landing_intervals(contact: BoolArray) -> int:
    """Count intervals of swings that land within the horizon, of contact (N + 1, L)."""
    knots, legs = contact.shape
    count = 0
    for leg in range(legs):
        waiting = 0
        for n in range(knots):
            if contact[n, leg]:
                count += waiting
                waiting = 0
            else:
                waiting += 1
    return count
