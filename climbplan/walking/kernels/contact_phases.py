"""Stance phases, objective value and receding-horizon shift of a gait, compiled.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.compiling import compiled

HELD = -1  # foothold of a toe that stands where it stood at the start
SWINGING = -2


@compiled
def find_stance_phases(contact: BoolArray) -> tuple[IntArray, IntArray]:
    """Number the free footholds of contacts (N + 1, L), leg by leg and in order of time.

    Returns:
        The index (N + 1, L) of each leg's foothold, `HELD` or `SWINGING`; and leg, first and last
        knot (F, 3) of each free foothold.
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
def compute_walk_cost(
    state: Array, force: Array, reference: Array, weight: Array, motion: float, difference: float
) -> float:
    """Return the objective of eq. (8.30).

    Args:
        state: (N + 1, 12) states.
        force: (>= N, L, 3) contact forces [N].
        reference: (N, 7) height, velocity and angles.
        weight: (7,) of deviations from the reference.
        motion: weight of the body's squared steps.
        difference: weight of squared force differences.
    """
    total = 0.0
    legs = force.shape[1]
    for n in range(1, state.shape[0]):
        for k in range(7):
            error = state[n, 2 + k] - reference[n - 1, k]
            total += weight[k] * error * error
        for k in range(3):
            step = state[n, k] - state[n - 1, k]
            total += motion * step * step
            squares, push = 0.0, 0.0
            for leg in range(legs):
                f = force[n - 1, leg, k]
                squares += f * f
                push += f
            total += 2.0 * difference * (legs * squares - push * push)
    return total


@compiled
def shift_horizon(
    contact: BoolArray, state: Array, force: Array, toes: Array
) -> tuple[BoolArray, Array, Array, Array]:
    """Shift a plan by one knot and extend its rhythm by one knot (receding horizon).

    Args:
        contact: (N + 1, L).
        state: (N + 1, 12).
        force: (N + 1, L, 3) [N].
        toes: (N + 1, L, 3) [m].

    Returns:
        Contacts (N + 1, L), states (N + 1, 12), forces (N, L, 3), and free footholds (F, 2) in the
        order of `find_stance_phases`.
    """
    last = contact.shape[0] - 1
    legs = contact.shape[1]
    contacts, states, forces = (
        np.empty_like(contact),
        np.empty_like(state),
        np.empty((last, legs, 3)),
    )
    for n in range(last + 1):
        for leg in range(legs):
            contacts[n, leg] = contact[n + 1 if n < last else last - 1, leg]
        for k in range(12):
            states[n, k] = state[min(n + 1, last), k]
    for n in range(last):
        for leg in range(legs):
            for k in range(3):
                forces[n, leg, k] = force[n + 1 if n < last - 1 else last - 2, leg, k]
    for k in range(3):
        states[last, k] += state[last, k] - state[last - 1, k]
    _, phases = find_stance_phases(contacts)
    spots = np.empty((phases.shape[0], 2))
    for index in range(phases.shape[0]):
        leg, first = phases[index, 0], phases[index, 1]
        knot = min(first + 1, last)
        for k in range(2):
            spots[index, k] = toes[knot, leg, k]
            if first == last:  # in the added knot
                spots[index, k] += state[last, k] - state[last - 1, k]
    return contacts, states, forces, spots
