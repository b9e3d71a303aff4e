"""What the controller is told at a tick, and whether it can be true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.task.task import POSITION, SPIN, VELOCITY, RigidBody

OLDEST = 0.1  # [s] of a measurement that is still used
_LARGEST_SPEED, _LARGEST_SPIN, _LARGEST_TILT = 8.0, 25.0, 1.4  # beyond: no measurement
_HEIGHTS = (0.02, 2.0)  # [m] of the body above the ground
_FARTHEST = 2.0  # [m] of a toe from the body


@dataclass(frozen=True)
class Situation:
    """What the controller knows at a knot: the body, its toes, and what legs just did."""

    state: Array  # (12,)
    toes: Array  # (L, 3) world [m]
    toes_before: Array  # (L, 3) one knot earlier
    contact_before: BoolArray  # (L,) from one knot earlier until now
    age: float = 0.0  # [s] since it was measured, beyond what was predicted since
    unfelt: tuple[int, ...] = ()  # legs that were to stand and feel no ground
    left: float = 0.0  # [s] until the next knot, where a plan is to begin between knots
    shorter: float = 0.0  # [s] of a first interval that may be taken where no plan holds; 0: none
    airborne: BoolArray | None = None  # (L,) then: in the air until that knot; None: no leg is


def fault_of(situation: Situation, body: RigidBody) -> str:
    """Why a measurement cannot be one, or is of no use; empty if it can be used."""
    parts = (situation.state, situation.toes, situation.toes_before)
    legs = body.leg_count
    shapes = ((12,), (legs, 3), (legs, 3))
    if any(part.shape != shape for part, shape in zip(parts, shapes, strict=True)):
        return "the measurement has another shape"
    numbers = np.concatenate([part.ravel() for part in parts])
    if not np.isfinite(numbers).all() or not np.isfinite(situation.age):
        return "the measurement is not a number"
    if situation.age > OLDEST:
        return f"the measurement is {1e3 * situation.age:.0f} ms old"
    state = situation.state
    if np.abs(state[VELOCITY]).max() > _LARGEST_SPEED or np.abs(state[SPIN]).max() > _LARGEST_SPIN:
        return "the measured speed is impossible"
    if not _HEIGHTS[0] < state[2] < _HEIGHTS[1]:
        return "the measured height is impossible"
    if np.abs(state[6:8]).max() > _LARGEST_TILT:
        return "the measured tilt leaves no way to stand"
    if np.abs(situation.toes - state[POSITION]).max() > _FARTHEST:
        return "the measured toes are nowhere near the body"
    if 2 * len(situation.unfelt) > legs:
        names = ", ".join(body.leg_names[leg] for leg in situation.unfelt)
        return f"{names} make no contact"
    return ""
