"""Stance phases and the objective's value, compiled: what each gait of a search needs anew."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.compiling import compiled

HELD = -1  # the toe stands where it stood at the start
SWINGING = -2


@compiled
def stance_phases(contact: BoolArray) -> tuple[IntArray, IntArray]:
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


@compiled
def left_of(
    contact: BoolArray, state: Array, force: Array, toes: Array
) -> tuple[BoolArray, Array, Array, Array]:
    """What is left of a plan after its first knot, and one more knot of the same rhythm.

    contact (N + 1, L), state (N + 1, 12), force and toes (N + 1, L, 3). Gives contact, state, force
    (N, L, 3) and free footholds (F, 2) as of `stance_phases`.
    """
    last = contact.shape[0] - 1
    legs = contact.shape[1]
    onward, states, forces = np.empty_like(contact), np.empty_like(state), np.empty((last, legs, 3))
    for n in range(last + 1):
        for leg in range(legs):
            onward[n, leg] = contact[n + 1 if n < last else last - 1, leg]
        for k in range(12):
            states[n, k] = state[min(n + 1, last), k]
    for n in range(last):
        for leg in range(legs):
            for k in range(3):
                forces[n, leg, k] = force[n + 1 if n < last - 1 else last - 2, leg, k]
    for k in range(3):
        states[last, k] += state[last, k] - state[last - 1, k]
    _, phases = stance_phases(onward)
    spots = np.empty((phases.shape[0], 2))
    for index in range(phases.shape[0]):
        leg, first = phases[index, 0], phases[index, 1]
        at = min(first + 1, last)
        for k in range(2):
            spots[index, k] = toes[at, leg, k]
            if first == last:  # in the knot that is new
                spots[index, k] += state[last, k] - state[last - 1, k]
    return onward, states, forces, spots
