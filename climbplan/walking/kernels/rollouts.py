"""What a plan's forces bring about in continuous time, and how far that is off it, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.body import moved
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.kernels.feet import place_toes, worst_beyond, worst_standing


@compiled
def rolled(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    center: Array,
    half: Array,
    steps: Array,
    parts: int,
    start: Array,
    toes: Array,
    force: Array,
    contact: BoolArray,
) -> tuple[Array, float]:
    """States (N + 1, 12) at knots that forces (N, L, 3) at toes (>= N, L, 3) bring about.

    And how far standing toes leave their boxes on the way from knot to knot [m], 0 if none does:
    between knots a body that rolls swings out and back. steps (N,) [s]: of the knots, each in so
    many parts.
    """
    states = np.empty((force.shape[0] + 1, 12))
    for k in range(12):
        states[0, k] = start[k]
    worst, once = 0.0, int(np.int64(1))  # as a literal it would be compiled for anew
    for n in range(force.shape[0]):
        here = states[n]
        for part in range(parts):
            here = moved(
                mass, gravity, inertia, inverse, steps[n] / parts, once, here, toes[n], force[n]
            )
            if part < parts - 1:
                worst = max(worst, worst_standing(center, half, here, toes[n], contact[n]))
        for k in range(12):
            states[n + 1, k] = here[k]
    return states, worst


@compiled
def borne_out(
    mass: float,
    gravity: float,
    inertia: Array,
    inverse: Array,
    center: Array,
    half: Array,
    steps: Array,
    parts: int,
    whole: bool,
    contact: BoolArray,
    foothold: IntArray,
    height: Array,
    start: Array,
    held: Array,
    spots: Array,
    base: Array,
    tilt: Array,
    predicted: Array,
    force: Array,
) -> tuple[Array, Array, float, float, float, float]:
    """The rollout of forces (N, L, 3) against the states (N + 1, 12) that a QP predicts of them.

    Toes are as of `place_toes`, held (L, 3) those at the start (12,). Gives states (N + 1, 12) and
    toes (N + 1, L, 3) of the rollout, how far it is off what was predicted [m/s] and [rad]
    (infinite where it is no number), and how far toes are out of their boxes at knots, as of
    `worst_beyond`, and standing ones between them [m].
    """
    toes = place_toes(center, half, foothold, predicted, height, held, spots, base, tilt)
    states, between = rolled(
        mass, gravity, inertia, inverse, center, half, steps, parts, start, toes, force, contact
    )
    speed, angle = 0.0, 0.0
    for n in range(states.shape[0]):
        for k in range(12):
            if not np.isfinite(states[n, k]):
                return states, toes, np.inf, np.inf, np.inf, np.inf
        for k in range(3):
            speed = max(speed, abs(states[n, 3 + k] - predicted[n, 3 + k]))
            angle = max(angle, abs(states[n, 6 + k] - predicted[n, 6 + k]))
    toes = place_toes(center, half, foothold, states, height, held, spots, base, tilt)
    reach = worst_beyond(center, half, whole, contact, states, toes)
    return states, toes, speed, angle, reach, between
