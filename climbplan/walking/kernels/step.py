"""The next state at a knot and its Jacobian, compiled: exact derivatives by the chain rule.

The same equations as `truth.knot_step` (8.14 to 8.19), which the tests hold it against.
"""

from __future__ import annotations

import numpy as np

from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task import Array

Triple = tuple[float, float, float]

_STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))  # Runge-Kutta: when, and its weight


# Vectors are triples of numbers here: arrays would be allocated some hundred times a knot.


@compiled
def _cross(a: Triple, b: Triple) -> Triple:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@compiled
def _minus(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def _times(A: Array, v: Triple) -> Triple:
    return (
        A[0, 0] * v[0] + A[0, 1] * v[1] + A[0, 2] * v[2],
        A[1, 0] * v[0] + A[1, 1] * v[1] + A[1, 2] * v[2],
        A[2, 0] * v[0] + A[2, 1] * v[1] + A[2, 2] * v[2],
    )


@compiled
def _times_transposed(A: Array, v: Triple) -> Triple:
    return (
        A[0, 0] * v[0] + A[1, 0] * v[1] + A[2, 0] * v[2],
        A[0, 1] * v[0] + A[1, 1] * v[1] + A[2, 1] * v[2],
        A[0, 2] * v[0] + A[1, 2] * v[1] + A[2, 2] * v[2],
    )


@compiled
def _rotation_slopes(R: Array, angles: Array, slopes: Array) -> None:
    """Slopes (3, 3, 3) of R^T by roll, pitch and yaw."""
    sr, sp, sy = np.sin(angles[0]), np.sin(angles[1]), np.sin(angles[2])
    cr, cp, cy = np.cos(angles[0]), np.cos(angles[1]), np.cos(angles[2])
    heading = np.empty(3)
    heading[0], heading[1], heading[2] = cy, sy, 0.0
    for j in range(3):
        slopes[0, 0, j], slopes[0, 1, j], slopes[0, 2, j] = 0.0, R[j, 2], -R[j, 1]
        rise = -cp if j == 2 else -sp * heading[j]
        slopes[1, 0, j] = rise
        along = -sp if j == 2 else cp * heading[j]
        slopes[1, 1, j], slopes[1, 2, j] = sr * along, cr * along
    for i in range(3):
        slopes[2, i, 0], slopes[2, i, 1], slopes[2, i, 2] = -R[1, i], R[0, i], 0.0


@compiled
def _turning(
    inertia: Array,
    inverse: Array,
    turn: Array,
    moment: Triple,
    rate: Array,
    by_turn: Array,
    by_moment: Array,
    work: Array,
) -> None:
    """Rates (6,) of Euler angles and angular velocity, eqs. (8.15), (8.17), with their slopes.

    turn (6,): angles and angular velocity; by_turn (6, 6); by_moment (3, 3): of the last three.
    """
    spin = (turn[3], turn[4], turn[5])
    sp, cp = np.sin(turn[1]), np.cos(turn[1])
    sy, cy = np.sin(turn[2]), np.cos(turn[2])
    along, across = cy * spin[0] + sy * spin[1], cy * spin[1] - sy * spin[0]
    by_turn[:] = 0.0
    rate[0], rate[1], rate[2] = along / cp, across, spin[2] + sp * along / cp
    by_turn[0, 1], by_turn[0, 2] = along * sp / cp**2, across / cp
    by_turn[0, 3], by_turn[0, 4] = cy / cp, sy / cp
    by_turn[1, 2], by_turn[1, 3], by_turn[1, 4] = -along, -sy, cy
    by_turn[2, 1], by_turn[2, 2] = along / cp**2, across * sp / cp
    by_turn[2, 3], by_turn[2, 4], by_turn[2, 5] = cy * sp / cp, sy * sp / cp, 1.0
    R, slopes = work[0], work[1:4]
    rotation(turn[:3], R)
    _rotation_slopes(R, turn[:3], slopes)
    # In the body frame, where the inertia is constant
    seen, felt = _times_transposed(R, spin), _times_transposed(R, moment)
    momentum = _times(inertia, seen)
    about = _times(inverse, _minus(felt, _cross(seen, momentum)))
    rate[3], rate[4], rate[5] = _times(R, about)
    for k in range(6):
        if k < 3:
            seen_k, felt_k = _times(slopes[k], spin), _times(slopes[k], moment)
        else:
            seen_k, felt_k = (R[k - 3, 0], R[k - 3, 1], R[k - 3, 2]), (0.0, 0.0, 0.0)
        gyration = _cross(seen, _times(inertia, seen_k))
        turned = _minus(_minus(felt_k, _cross(seen_k, momentum)), gyration)
        change = _times(R, _times(inverse, turned))
        by_turn[3, k], by_turn[4, k], by_turn[5, k] = change
        if k < 3:
            change = _times_transposed(slopes[k], about)
            by_turn[3, k] += change[0]
            by_turn[4, k] += change[1]
            by_turn[5, k] += change[2]
    for j in range(3):
        column = _times(R, _times(inverse, (R[j, 0], R[j, 1], R[j, 2])))
        by_moment[0, j], by_moment[1, j], by_moment[2, j] = column


@compiled
def _moment(
    position: Array, toes: Array, force: Array, ahead: float, mass: float, by: Array
) -> Triple:
    """The moment (3,) about a body at a position (3,), and its slopes (3, 36) at the knot's start.

    ahead [s]: how long the body has moved on since, its position included.
    """
    legs = toes.shape[0]
    x, y, z = 0.0, 0.0, 0.0
    push = np.zeros(3)
    by[:] = 0.0
    for leg in range(legs):
        arm = (
            toes[leg, 0] - position[0],
            toes[leg, 1] - position[1],
            toes[leg, 2] - position[2],
        )
        f = (force[leg, 0], force[leg, 1], force[leg, 2])
        turn = _cross(arm, f)
        x, y, z = x + turn[0], y + turn[1], z + turn[2]
        for k in range(3):
            push[k] += f[k]
            i, j = (k + 1) % 3, (k + 2) % 3
            toe, pull = 12 + 3 * leg + k, 24 + 3 * leg + k
            by[i, toe], by[j, toe] = -f[j], f[i]
            by[i, pull], by[j, pull] = arm[j], -arm[i]
    shift = 0.5 * ahead * ahead / mass  # how far a unit of force moved the body
    for k in range(3):
        # - e x push by the position, and by what moves it
        i, j = (k + 1) % 3, (k + 2) % 3
        by[i, k], by[j, k] = push[j], -push[i]
        by[i, 3 + k], by[j, 3 + k] = ahead * push[j], -ahead * push[i]
        for leg in range(legs):
            by[i, 24 + 3 * leg + k] += shift * push[j]
            by[j, 24 + 3 * leg + k] -= shift * push[i]
    return x, y, z


@compiled
def linearised(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    dt: float,
    mean: bool,
    state: Array,
    toes: Array,
    force: Array,
    after: Array,
    jacobian: Array,
) -> None:
    """States one knot later and their slopes at N knots.

    mean: as the integrator of that name, else forward Euler. state (>= N, 12), toes (>= N, 4, 3),
    force (N, 4, 3). Writes after (N, 12) and jacobian (N, 36, 12): by state, toes and forces.
    """
    rate, by_turn, by_moment = np.empty(6), np.empty((6, 6)), np.empty((3, 3))
    by, slope, change = np.empty((3, 36)), np.empty((6, 36)), np.empty((6, 36))
    turn, total, sum_by = np.empty(6), np.empty(6), np.empty((6, 36))
    push, position, work = np.empty(3), np.empty(3), np.empty((4, 3, 3))
    for n in range(force.shape[0]):
        J = jacobian[n]
        J[:] = 0.0
        for i in range(3):
            push[i] = 0.0
            for leg in range(toes.shape[1]):
                push[i] += force[n, leg, i]
        # Newton, eq. (8.14): along a parabola, or by forward Euler
        bend = 0.5 * dt * dt if mean else 0.0
        for i in range(3):
            a = push[i] / mass - (gravity if i == 2 else 0.0)
            after[n, i] = state[n, i] + dt * state[n, 3 + i] + bend * a
            after[n, 3 + i] = state[n, 3 + i] + dt * a
            J[i, i], J[3 + i, i], J[3 + i, 3 + i] = 1.0, dt, 1.0
            for leg in range(toes.shape[1]):
                J[24 + 3 * leg + i, i] = bend / mass
                J[24 + 3 * leg + i, 3 + i] = dt / mass
        # Euler, eq. (8.15), by Runge-Kutta over the interval, or at its start
        total[:], sum_by[:] = 0.0, 0.0
        rate[:], slope[:] = 0.0, 0.0
        weights = 0.0
        for when, weight in _STAGES:
            ahead = when * dt
            for i in range(6):
                turn[i] = state[n, 6 + i] + ahead * rate[i]
            for i in range(3):
                a = push[i] / mass - (gravity if i == 2 else 0.0)
                position[i] = state[n, i] + ahead * (state[n, 3 + i] + 0.5 * ahead * a)
            moment = _moment(position, toes[n], force[n], ahead, mass, by)
            _turning(inertia, inverse, turn, moment, rate, by_turn, by_moment, work)
            for i in range(6):
                row = change[i]
                for c in range(36):
                    row[c] = by_turn[i, c - 6] if 6 <= c < 12 else 0.0
                if ahead > 0.0:
                    for j in range(6):
                        s = ahead * by_turn[i, j]
                        for c in range(36):
                            row[c] += s * slope[j, c]
                if i >= 3:
                    for j in range(3):
                        s = by_moment[i - 3, j]
                        for c in range(36):
                            row[c] += s * by[j, c]
            slope[:] = change
            total += weight * rate
            sum_by += weight * slope
            weights += weight
            if not mean:
                break
        share = dt / weights
        for i in range(6):
            after[n, 6 + i] = state[n, 6 + i] + share * total[i]
            for c in range(36):
                J[c, 6 + i] = share * sum_by[i, c]
            J[6 + i, 6 + i] += 1.0
