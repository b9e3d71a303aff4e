"""The rigid body in continuous time, compiled: simulation of loops and validation of plans.

Its rates are generated from the formulation in `dynamics/` (`dynamics_step.py`).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.dynamics_step import rates, sum_contact_wrench
from climbplan.walking.task.task import BodyParameters

NUM_SUBSTEPS = 4  # Runge-Kutta steps of an interval in rollouts: 20 ms of 80 ms


@compiled
def rotation(angles: Array, R: Array) -> None:
    """Write the body-to-world rotation of roll, pitch, yaw (3,) into R (3, 3), eq. (8.16)."""
    sr, sp, sy = np.sin(angles[0]), np.sin(angles[1]), np.sin(angles[2])
    cr, cp, cy = np.cos(angles[0]), np.cos(angles[1]), np.cos(angles[2])
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr


@compiled
def integrate_rk4(
    body: BodyParameters, dt: float, num_steps: int, start: Array, toes: Array, force: Array
) -> Array:
    """Integrate the rigid-body dynamics by the classical Runge-Kutta method (RK4).

    Args:
        body: mass properties.
        dt: length of time [s].
        num_steps: Runge-Kutta steps.
        start: (12,) first state.
        toes: (L, 3) constant toes, world frame [m].
        force: (L, 3) constant contact forces, world frame [N].

    Returns:
        The state (12,) after dt.
    """
    mass, gravity = body.mass, body.gravity
    # Generated code needs C-ordered arrays, and copies are.
    inertia, inverse = body.inertia.copy(), body.inverse_inertia.copy()
    push, about_origin = np.empty(3), np.empty(3)
    sum_contact_wrench(toes, force, push, about_origin)
    state, stage = start.copy(), np.empty(12)
    k1, k2, k3, k4 = np.empty(12), np.empty(12), np.empty(12), np.empty(12)
    h = dt / num_steps
    for _ in range(num_steps):
        rates((mass, gravity, inertia, inverse, state, push, about_origin), (k1,))
        for i in range(12):
            stage[i] = state[i] + 0.5 * h * k1[i]
        rates((mass, gravity, inertia, inverse, stage, push, about_origin), (k2,))
        for i in range(12):
            stage[i] = state[i] + 0.5 * h * k2[i]
        rates((mass, gravity, inertia, inverse, stage, push, about_origin), (k3,))
        for i in range(12):
            stage[i] = state[i] + h * k3[i]
        rates((mass, gravity, inertia, inverse, stage, push, about_origin), (k4,))
        for i in range(12):
            state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    return state
