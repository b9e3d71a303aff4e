"""The rigid body in continuous time, compiled: what loops simulate and ticks are judged by.

Its rates are generated from the declaration (`step.py`); the tests hold it against `truth.py`.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.step import net_load, rates

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
    """The state (12,) after dt with toes (L, 3) and forces constant, in `parts` RK4 steps."""
    # Copies are C-ordered, which what is given need not be
    inertia, inverse = inertia.copy(), inverse.copy()
    push, about_origin = np.empty(3), np.empty(3)
    net_load(toes, force, push, about_origin)
    state, at = start.copy(), np.empty(12)
    k1, k2, k3, k4 = np.empty(12), np.empty(12), np.empty(12), np.empty(12)
    h = dt / parts
    for _ in range(parts):
        rates((mass, gravity, inertia, inverse, state, push, about_origin), (k1,))
        for i in range(12):
            at[i] = state[i] + 0.5 * h * k1[i]
        rates((mass, gravity, inertia, inverse, at, push, about_origin), (k2,))
        for i in range(12):
            at[i] = state[i] + 0.5 * h * k2[i]
        rates((mass, gravity, inertia, inverse, at, push, about_origin), (k3,))
        for i in range(12):
            at[i] = state[i] + h * k3[i]
        rates((mass, gravity, inertia, inverse, at, push, about_origin), (k4,))
        for i in range(12):
            state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    return state
