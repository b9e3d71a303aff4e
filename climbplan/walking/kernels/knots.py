"""Knots one after another, compiled: what the forces of a plan bring about, step by step.

The same equations as `truth.knot_step` (8.14 to 8.19), which the tests hold it against.
"""

from __future__ import annotations

import numpy as np

from climbplan.walking.kernels.body import derivative
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task import Array

_STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))  # Runge-Kutta: when, and its weight


@compiled
def knots_rolled(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    dt: float,
    mean: bool,
    start: Array,
    toes: Array,
    force: Array,
) -> Array:
    """States (N + 1, 12) that forces (N, 4, 3) at toes (>= N, 4, 3) bring about from a start (12,).

    mean: as the integrator of that name, else forward Euler; inverse: of the inertia, body frame.
    """
    knots = force.shape[0]
    states = np.empty((knots + 1, 12))
    rate, at, slope, total = np.empty(12), np.empty(12), np.empty(6), np.empty(6)
    states[0] = start
    for n in range(knots):
        here, after = states[n], states[n + 1]
        derivative(mass, gravity, inertia, inverse, here, toes[n], force[n], rate)
        if not mean:
            for i in range(12):
                after[i] = here[i] + dt * rate[i]
            continue
        # The body moves on along a parabola and turns under the moments of where it is then.
        for i in range(3):
            after[i] = here[i] + dt * (here[3 + i] + 0.5 * dt * rate[3 + i])
            after[3 + i] = here[3 + i] + dt * rate[3 + i]
        total[:], slope[:] = 0.0, 0.0
        at[:] = here
        for when, weight in _STAGES:
            ahead = when * dt
            if ahead > 0.0:
                for i in range(3):
                    at[i] = here[i] + ahead * (here[3 + i] + 0.5 * ahead * rate[3 + i])
                for i in range(6):
                    at[6 + i] = here[6 + i] + ahead * slope[i]
                derivative(mass, gravity, inertia, inverse, at, toes[n], force[n], rate)
            for i in range(6):
                slope[i] = rate[6 + i]
                total[i] += weight * slope[i]
        for i in range(6):
            after[6 + i] = here[6 + i] + dt / 6.0 * total[i]
    return states
