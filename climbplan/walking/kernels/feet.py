"""Where toes are and how far out of their boxes, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import rotation
from climbplan.walking.kernels.compiling import compiled


@compiled
def _swinging(center: Array, half: Array, R: Array, position: Array, height: float) -> Array:
    """A swinging toe (3,) at a height, near the middle of its box.

    A tilted body may have to draw a toe in or stretch it to keep it within its box: it goes just so
    far to the corner where it is higher, or lower, in the body.
    """
    down, rise = R[2, 2], height - position[2]
    reach_x, reach_y = half[0] * np.sign(R[2, 0]), half[1] * np.sign(R[2, 1])
    here = (rise - R[2, 0] * center[0] - R[2, 1] * center[1]) / down
    turn = (R[2, 0] * reach_x + R[2, 1] * reach_y) / down
    least, most = here - turn, here + turn
    ceiling, floor = center[2] + half[2], center[2] - half[2]
    drawn = min(max((here - ceiling) / max(here - least, 1e-9), 0.0), 1.0)
    stretched = min(max((floor - here) / max(most - here, 1e-9), 0.0), 1.0)
    spot = np.empty(3)
    spot[0] = center[0] + (drawn - stretched) * reach_x
    spot[1] = center[1] + (drawn - stretched) * reach_y
    spot[2] = (rise - R[2, 0] * spot[0] - R[2, 1] * spot[1]) / down
    toe = np.empty(3)
    for i in range(3):
        toe[i] = position[i] + R[i, 0] * spot[0] + R[i, 1] * spot[1] + R[i, 2] * spot[2]
    return toe


@compiled
def place_toes(
    center: Array,
    half: Array,
    foothold: IntArray,
    state: Array,
    height: Array,
    start: Array,
    spots: Array,
    base: Array,
    tilt: Array,
) -> Array:
    """All toes (N + 1, L, 3): standing ones at their footholds, others under the body.

    center (L, 3) and half (3,): workspace boxes; foothold (N + 1, L) as of `Footing`: of a free
    one its index, -1 where the toe is held from the start, below that swinging; state (N + 1, 12);
    height (N + 1, L) of swinging ones; start (L, 3); spots (F, 2) the free footholds; their
    heights are base (F,) + tilt (F, 2) spots.
    """
    knots, legs = foothold.shape
    toes, R = np.empty((knots, legs, 3)), np.empty((3, 3))
    for n in range(knots):
        rotation(state[n, 6:9], R)
        for leg in range(legs):
            index = foothold[n, leg]
            if n == 0 or index == -1:
                for k in range(3):
                    toes[n, leg, k] = start[leg, k]
            elif index >= 0:
                toes[n, leg, 0], toes[n, leg, 1] = spots[index, 0], spots[index, 1]
                toes[n, leg, 2] = base[index]
                for k in range(2):
                    toes[n, leg, 2] += tilt[index, k] * spots[index, k]
            else:
                toe = _swinging(center[leg], half, R, state[n], height[n, leg])
                for k in range(3):
                    toes[n, leg, k] = toe[k]
    return toes


@compiled
def beyond_box(center: Array, half: Array, R: Array, state: Array, toe: Array) -> float:
    """How far a toe (3,) is outside its box [m]; below zero inside. R: of the state."""
    worst = -np.inf
    for i in range(3):
        seen = 0.0
        for j in range(3):
            seen += R[j, i] * (toe[j] - state[j])
        worst = max(worst, abs(seen - center[i]) - half[i])
    return worst


@compiled
def worst_beyond(
    center: Array, half: Array, whole: bool, contact: BoolArray, state: Array, toes: Array
) -> float:
    """How far toes leave their boxes at knots 1 to N, and standing ones at knot 0 [m].

    whole: standing ones also at the end of their interval, before they lift.
    """
    worst, R = -np.inf, np.empty((3, 3))
    for n in range(state.shape[0]):
        rotation(state[n, 6:9], R)
        for leg in range(center.shape[0]):
            if n > 0 or contact[n, leg]:
                worst = max(worst, beyond_box(center[leg], half, R, state[n], toes[n, leg]))
            if whole and n > 0 and contact[n - 1, leg]:
                worst = max(worst, beyond_box(center[leg], half, R, state[n], toes[n - 1, leg]))
    return worst


@compiled
def worst_standing(
    center: Array, half: Array, state: Array, toes: Array, contact: BoolArray
) -> float:
    """How far standing toes (L, 3) are out of their boxes in a state (12,) [m]; 0 if none is."""
    worst, R = 0.0, np.empty((3, 3))
    rotation(state[6:9], R)
    for leg in range(center.shape[0]):
        if contact[leg]:
            worst = max(worst, beyond_box(center[leg], half, R, state, toes[leg]))
    return worst


@compiled
def each_within(
    center: Array, half: Array, state: Array, toes: Array, slack: float, dt: float, room: float
) -> BoolArray:
    """(L,) legs whose toes (L, 3) are within `slack` of their boxes in a state (12,).

    And within `room` [m] where its velocity takes the body in the time dt [s], if that is not 0.
    """
    legs, R = center.shape[0], np.empty((3, 3))
    within, later = np.empty(legs, np.bool_), state.copy()
    rotation(state[6:9], R)
    for k in range(3):
        later[k] += dt * state[3 + k]
    for leg in range(legs):
        within[leg] = beyond_box(center[leg], half, R, state, toes[leg]) <= slack
        if within[leg] and dt > 0.0:
            within[leg] = beyond_box(center[leg], half, R, later, toes[leg]) <= room
    return within
