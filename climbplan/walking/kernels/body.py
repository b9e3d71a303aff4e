"""The rigid body in continuous time, compiled: what loops simulate and ticks are judged by.

The same equations as `truth.py` (8.14 to 8.17), which the tests hold it against.
"""

from __future__ import annotations

import numpy as np

from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task import Array

PARTS = 4  # Runge-Kutta steps of a knot in rollouts: 20 ms at 80 ms


@compiled
def rotation(angles: Array, R: Array) -> None:
    """Body-to-world rotation of roll, pitch, yaw into R (3, 3), eq. (8.16)."""
    sr, sp, sy = np.sin(angles[0]), np.sin(angles[1]), np.sin(angles[2])
    cr, cp, cy = np.cos(angles[0]), np.cos(angles[1]), np.cos(angles[2])
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr


@compiled
def derivative(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    state: Array,
    toes: Array,
    force: Array,
    rate: Array,
) -> None:
    """Time derivative of the state (12,) into rate; inverse: of the inertia, body frame."""
    R = np.empty((3, 3))
    rotation(state[6:9], R)
    push, moment = np.zeros(3), np.zeros(3)
    for leg in range(toes.shape[0]):
        x, y, z = toes[leg, 0] - state[0], toes[leg, 1] - state[1], toes[leg, 2] - state[2]
        fx, fy, fz = force[leg, 0], force[leg, 1], force[leg, 2]
        push[0] += fx
        push[1] += fy
        push[2] += fz
        moment[0] += y * fz - z * fy
        moment[1] += z * fx - x * fz
        moment[2] += x * fy - y * fx
    # Euler, eq. (8.15), in the body frame, where the inertia is constant
    seen, turning = np.zeros(3), np.zeros(3)
    for i in range(3):
        for j in range(3):
            seen[i] += R[j, i] * state[9 + j]
            turning[i] += R[j, i] * moment[j]
    momentum = np.zeros(3)
    for i in range(3):
        for j in range(3):
            momentum[i] += inertia[i, j] * seen[j]
    turning[0] -= seen[1] * momentum[2] - seen[2] * momentum[1]
    turning[1] -= seen[2] * momentum[0] - seen[0] * momentum[2]
    turning[2] -= seen[0] * momentum[1] - seen[1] * momentum[0]
    about = np.zeros(3)
    for i in range(3):
        for j in range(3):
            about[i] += inverse[i, j] * turning[j]
    # Euler rates, eq. (8.17) solved for them
    sy, cy = np.sin(state[8]), np.cos(state[8])
    roll = (cy * state[9] + sy * state[10]) / np.cos(state[7])
    rate[6] = roll
    rate[7] = cy * state[10] - sy * state[9]
    rate[8] = state[11] + np.sin(state[7]) * roll
    for i in range(3):
        rate[i] = state[3 + i]
        rate[3 + i] = push[i] / mass
        rate[9 + i] = R[i, 0] * about[0] + R[i, 1] * about[1] + R[i, 2] * about[2]
    rate[5] -= gravity


@compiled
def moved(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    dt: float,
    parts: int,
    start: Array,
    toes: Array,
    force: Array,
) -> Array:
    """The state (12,) after dt with toes (4, 3) and forces constant, in `parts` RK4 steps."""
    state, at = start.copy(), np.empty(12)
    k1, k2, k3, k4 = np.empty(12), np.empty(12), np.empty(12), np.empty(12)
    h = dt / parts
    for _ in range(parts):
        derivative(mass, gravity, inertia, inverse, state, toes, force, k1)
        for i in range(12):
            at[i] = state[i] + 0.5 * h * k1[i]
        derivative(mass, gravity, inertia, inverse, at, toes, force, k2)
        for i in range(12):
            at[i] = state[i] + 0.5 * h * k2[i]
        derivative(mass, gravity, inertia, inverse, at, toes, force, k3)
        for i in range(12):
            at[i] = state[i] + h * k3[i]
        derivative(mass, gravity, inertia, inverse, at, toes, force, k4)
        for i in range(12):
            state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    return state


@compiled
def rolled(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    dt: float,
    parts: int,
    start: Array,
    toes: Array,
    force: Array,
) -> Array:
    """States (N + 1, 12) at knots that forces (N, 4, 3) at toes (>= N, 4, 3) bring about."""
    states = np.empty((force.shape[0] + 1, 12))
    states[0] = start
    for n in range(force.shape[0]):
        states[n + 1] = moved(
            mass, gravity, inertia, inverse, dt, parts, states[n], toes[n], force[n]
        )
    return states
