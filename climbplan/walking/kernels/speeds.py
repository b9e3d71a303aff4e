"""How fast joints of standing and swinging legs turn, as rows on states and footholds, compiled.

dq/dt = J^+ R' (dx/dt - v - w x (x - p)) of a toe at x over a body at p, that moves by v and turns
by w. J, R and x - p are those of the point of linearisation, as of torques.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.legs import leg_jacobian

GLANCES = 9  # at each interval of a swing
_FIRST, _APART = 0.1, 0.1  # shares of the interval where they are
_FAR_FROM = 0.5  # of a limit, below which there is no row
_DAMPED = 1e-8  # of the Jacobian's squared size


@compiled
def _inverted(jacobian: Array, R: Array, turned: Array) -> None:
    """J^+ R' (J, 3) of a Jacobian (3, J)."""
    square = jacobian @ jacobian.T
    damping = _DAMPED * (square[0, 0] + square[1, 1] + square[2, 2])
    for i in range(3):
        square[i, i] += damping
    turned[:] = jacobian.T @ np.linalg.solve(square, np.ascontiguousarray(R.T))


@compiled
def _between(state: Array, n: int, u: float, step: float, place: Array, angles: Array) -> None:
    """Where the body is (3,) and how it is turned (3,) at a share u of interval n: cubics."""
    first, last = u * (1.0 - u) ** 2 * step, -(u**2) * (1.0 - u) * step
    other = u**2 * (3.0 - 2.0 * u)
    for k in range(3):
        place[k] = (1.0 - other) * state[n, k] + other * state[n + 1, k]
        place[k] += first * state[n, 3 + k] + last * state[n + 1, 3 + k]
        angles[k] = (1.0 - other) * state[n, 6 + k] + other * state[n + 1, 6 + k]
    for m, part in ((n, first), (n + 1, last)):
        sp, cp = np.sin(state[m, 7]), np.cos(state[m, 7])
        sy, cy = np.sin(state[m, 8]), np.cos(state[m, 8])
        roll = (cy * state[m, 9] + sy * state[m, 10]) / cp
        angles[0] += part * roll
        angles[1] += part * (cy * state[m, 10] - sy * state[m, 9])
        angles[2] += part * (state[m, 11] + sp * roll)


@compiled
def _body_row(
    g: Array, arm: Array, angles: Array, n: int, u: float, step: float,
    offset: Array, by: Array, row: Array,
) -> float:  # fmt: skip
    """Adds g' (-v - w x arm) at a share u of interval n to a row (Z,); returns its constant.

    v and w are rates of the cubics through both knots.
    """
    turn = np.empty(3)  # g' (-w x arm) = w' (g x arm)
    turn[0] = g[1] * arm[2] - g[2] * arm[1]
    turn[1] = g[2] * arm[0] - g[0] * arm[2]
    turn[2] = g[0] * arm[1] - g[1] * arm[0]
    sp, cp, sy, cy = np.sin(angles[1]), np.cos(angles[1]), np.sin(angles[2]), np.cos(angles[2])
    euler = np.empty(3)  # the same by rates of roll, pitch, yaw
    euler[0] = cp * (cy * turn[0] + sy * turn[1]) - sp * turn[2]
    euler[1] = cy * turn[1] - sy * turn[0]
    euler[2] = turn[2]
    apart = 6.0 * u * (1.0 - u) / step
    constant = 0.0
    for m, rate, value in (
        (n, 1.0 - 4.0 * u + 3.0 * u**2, -apart),
        (n + 1, 3.0 * u**2 - 2.0 * u, apart),
    ):
        for first, weight, each in (
            (0, -value, g), (3, -rate, g), (6, value, euler), (9, rate, turn),
        ):  # fmt: skip
            if weight == 0.0:
                continue
            for k in range(3):
                part = weight * each[k]
                constant += part * offset[m, first + k]
                source = by[m, first + k]
                for c in range(row.shape[0]):
                    row[c] += part * source[c]
    return constant


@compiled
def speed_rows(
    joint: Array,
    axis: Array,
    slide: Array,
    drive: Array,
    toe: Array,
    posture: Array,
    most: Array,
    steps: Array,
    lift: float,
    state: Array,
    toes: Array,
    contact: BoolArray,
    foothold: IntArray,
    spots: Array,
    tilt: Array,
    offset: Array,
    by: Array,
    foot_unit: float,
    foot_column: int,
    rows: Array,
    lower: Array,
    upper: Array,
) -> int:
    """Rows (M, Z) and bounds (M,): joint speeds within most (L, J), in units of it; how many.

    Of standing legs at both ends of an interval, of swinging ones at `GLANCES` shares of each
    interval of a way that lands within the horizon: J (2 F + GLANCES S) at most, without those far
    from their limits at the point. Legs as of `torque_rows`, steps (N,), states as offset + by z;
    foothold (N + 1, L), spots and tilt (F, 2). Where a leg does not reach nothing is said: its
    workspace rows do.
    """
    knots, legs = contact.shape
    joints = joint.shape[1]
    R, jacobian, g = np.empty((3, 3)), np.empty((3, joints)), np.empty((joints, 3))
    place, arm, angles, moving = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    slow = np.empty(0)  # a row of nothing
    bare = np.empty((knots, 12, 0))
    count = 0
    for leg in range(legs):
        for n in range(knots - 1):
            lifts, lands = n, n  # of the swing that interval n is of
            while lifts > 0 and not contact[lifts - 1, leg]:
                lifts -= 1
            while lands < knots and not contact[lands, leg]:
                lands += 1
            if lands == knots:
                continue
            stands = contact[n, leg]
            left = n if stands else max(lifts - 1, 0)
            span, since = 0.0, 0.0
            top = max(toes[left, leg, 2], toes[lands, leg, 2]) + lift
            for m in range(lifts, lands):
                span += steps[m]
                since += steps[m] if m < n else 0.0
                top = max(top, toes[m, leg, 2])
            high = top - 0.5 * (toes[left, leg, 2] + toes[lands, leg, 2])
            for glance in range(2 if stands else GLANCES):
                u, rate = float(glance), 0.0
                moving[:] = 0.0
                arm[:] = toes[left, leg]
                if not stands:
                    u = _FIRST + _APART * glance
                    s = (since + u * steps[n]) / span
                    part = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
                    rate = 30.0 * s**2 * (1.0 - s) ** 2 / span
                    for k in range(3):
                        across = toes[lands, leg, k] - toes[left, leg, k]
                        arm[k] += part * across
                        moving[k] = rate * across
                    arm[2] += 16.0 * s**2 * (1.0 - s) ** 2 * high
                    moving[2] += 32.0 * s * (1.0 - s) * (1.0 - 2.0 * s) * high / span
                _between(state, n, u, steps[n], place, angles)
                arm -= place
                rotation(angles, R)
                if not leg_jacobian(
                    joint[leg], axis[leg], slide[leg], drive[leg], toe[leg], posture[leg],
                    R.T @ arm, jacobian,
                ):  # fmt: skip
                    continue
                _inverted(jacobian, R, g)
                for j in range(joints):
                    g[j] /= most[leg, j]
                    constant = g[j] @ moving
                    now = constant + _body_row(g[j], arm, angles, n, u, steps[n], state, bare, slow)
                    if abs(now) < _FAR_FROM:
                        continue
                    row = rows[count]
                    row[:] = 0.0
                    constant += _body_row(g[j], arm, angles, n, u, steps[n], offset, by, row)
                    for knot, sign in ((left, -rate), (lands, rate)):
                        index = foothold[knot, leg]
                        if index < 0 or stands:  # where it stood at the start
                            continue
                        for k in range(2):
                            by_spot = sign * (g[j, k] + g[j, 2] * tilt[index, k])
                            row[foot_column + 2 * index + k] += by_spot * foot_unit
                            constant -= by_spot * spots[index, k]
                    lower[count], upper[count] = -1.0 - constant, 1.0 - constant
                    count += 1
    return count


@compiled
def landing_intervals(contact: BoolArray) -> int:
    """Intervals of swings that land within the horizon, of contact (N + 1, L)."""
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
