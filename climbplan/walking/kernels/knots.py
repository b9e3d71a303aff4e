"""Knots one after another, compiled: what the forces of a plan bring about, step by step."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.step import euler_step, mean_step, net_load


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
    """States (N + 1, 12) that forces (N, L, 3) at toes (>= N, L, 3) bring about from a start (12,).

    steps (N,) [s] of the knots; mean: as the integrator of that name, else forward Euler;
    inverse: of the inertia, body frame.
    """
    knots = force.shape[0]
    states = np.empty((knots + 1, 12))
    # Copies are C-ordered, which what is given need not be
    inertia, inverse = inertia.copy(), inverse.copy()
    push, about_origin = np.empty(3), np.empty(3)
    states[0] = start
    for n in range(knots):
        net_load(toes[n], force[n], push, about_origin)
        given = (mass, gravity, inertia, inverse, states[n], push, about_origin, steps[n])
        if mean:
            mean_step(given, (states[n + 1],))
        else:
            euler_step(given, (states[n + 1],))
    return states
