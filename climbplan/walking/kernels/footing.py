"""Stance phases and the objective's value, compiled: what each gait of a search needs anew."""

from __future__ import annotations

import numpy as np

from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task import Array, Flags, Whole

HELD = -1  # the toe stands where it stood at the start
SWINGING = -2


@compiled
def stance_phases(contact: Flags) -> tuple[Whole, Whole]:
    """Footholds (N + 1, L) as of `Footing`, and leg, first and last knot (F, 3) of the free ones.

    contact (N + 1, L). Leg by leg, in the order in which they are stood on.
    """
    knots, legs = contact.shape
    foothold = np.full((knots, legs), SWINGING, np.int64)
    phases = np.empty((knots * legs, 3), np.int64)
    count = 0
    for leg in range(legs):
        for n in range(knots):
            if not contact[n, leg]:
                continue
            if n == 0:
                foothold[n, leg] = HELD
            elif contact[n - 1, leg]:
                foothold[n, leg] = foothold[n - 1, leg]
                if foothold[n, leg] >= 0:
                    phases[count - 1, 2] = n
            else:
                foothold[n, leg] = count
                phases[count, 0], phases[count, 1], phases[count, 2] = leg, n, n
                count += 1
    return foothold, phases[:count].copy()


@compiled
def walk_cost(
    state: Array, force: Array, wanted: Array, weight: Array, motion: float, difference: float
) -> float:
    """The objective of eq. (8.30), as `cost.objective`.

    state (N + 1, 12); force (>= N, L, 3); wanted (N, 7) and weight (7,): of height, velocity and
    angles; motion, difference: weights of the body's steps and of force differences.
    """
    total = 0.0
    legs = force.shape[1]
    for n in range(1, state.shape[0]):
        for k in range(7):
            off = state[n, 2 + k] - wanted[n - 1, k]
            total += weight[k] * off * off
        for k in range(3):
            moved = state[n, k] - state[n - 1, k]
            total += motion * moved * moved
            squares, push = 0.0, 0.0
            for leg in range(legs):
                f = force[n - 1, leg, k]
                squares += f * f
                push += f
            total += 2.0 * difference * (legs * squares - push * push)
    return total
