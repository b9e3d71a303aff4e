"""Rollout of the discrete-time dynamics, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.dynamics_step import euler_step, mean_step, sum_contact_wrench
from climbplan.walking.task.task import BodyParameters


@compiled
def roll_out_knots(
    body: BodyParameters, steps: Array, use_mean: bool, start: Array, toes: Array, force: Array
) -> Array:
    """Roll out the discrete-time dynamics from a start.

    Args:
        body: mass properties.
        steps: (N,) lengths of the intervals [s].
        use_mean: integrator `mean`, else forward Euler.
        start: (12,) first state.
        toes: (>= N, L, 3) world frame [m].
        force: (N, L, 3) world frame [N].

    Returns:
        States (N + 1, 12).
    """
    knots = force.shape[0]
    states = np.empty((knots + 1, 12))
    # Generated code needs C-ordered arrays, and copies are.
    inertia, inverse = body.inertia.copy(), body.inverse_inertia.copy()
    push, about_origin = np.empty(3), np.empty(3)
    states[0] = start
    for n in range(knots):
        sum_contact_wrench(toes[n], force[n], push, about_origin)
        inputs = (
            body.mass, body.gravity, inertia, inverse, states[n], push, about_origin, steps[n]
        )  # fmt: skip
        if use_mean:
            mean_step(inputs, (states[n + 1],))
        else:
            euler_step(inputs, (states[n + 1],))
    return states
