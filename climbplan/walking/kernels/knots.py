"""Knots one after another, compiled: what the forces of a plan bring about, step by step."""

from __future__ import annotations

import numpy as np

from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.step import euler_step, mean_step
from climbplan.walking.task import Array


@compiled
def knots_rolled(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    steps: Array,
    mean: bool,
    start: Array,
    toes: Array,
    force: Array,
) -> Array:
    """States (N + 1, 12) that forces (N, 4, 3) at toes (>= N, 4, 3) bring about from a start (12,).

    steps (N,) [s] of the knots; mean: as the integrator of that name, else forward Euler;
    inverse: of the inertia, body frame.
    """
    knots = force.shape[0]
    states = np.empty((knots + 1, 12))
    # Copies are C-ordered, which what is given need not be
    inertia, inverse = inertia.copy(), inverse.copy()
    spots, pushes = np.empty((4, 3)), np.empty((4, 3))
    states[0] = start
    for n in range(knots):
        spots[:], pushes[:] = toes[n], force[n]
        given = (mass, gravity, inertia, inverse, states[n], spots, pushes, steps[n])
        if mean:
            mean_step(given, (states[n + 1],))
        else:
            euler_step(given, (states[n + 1],))
    return states
