"""Spatial branching on the tube: the union of several tubes covers what one wide tube would.

What turns is linear about the middle of a tube, so that a wide one leaves envelopes room. Where two
narrower ones about parts of the motions have better bounds they take its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.tube import Tube, tube_about
from climbplan.walking.task.task import ANGLES, SPIN, WalkTask

_WORTH = 0.02  # of what is enough, that two tubes have to raise the bound by


@dataclass(frozen=True, eq=False)
class Leaf:
    """A tube, the motions that it is about, and a bound of what moves within it."""

    tube: Tube
    motions: Array  # (M, N + 1, 12)
    bound: float


def covering(
    task: WalkTask,
    motions: Array,
    width: tuple[Array, Array],
    enough: float,
    bound: Callable[[Tube], float],
    goes_on: Callable[[], bool],
) -> list[Leaf]:
    """Tubes that together hold all motions (M, N + 1, 12), with so much room either way.

    The one with the lowest bound is parted for as long as that raises it by a share of what is
    enough. width: of angles and of angular velocities, (3,) each.
    """

    def leaf(held: Array) -> Leaf:
        tube = tube_about(task, held, *width)
        return Leaf(tube, held, bound(tube))

    waiting, whole = [leaf(motions)], list[Leaf]()
    while waiting and goes_on():
        lowest = min(waiting, key=lambda one: one.bound)
        if lowest.bound >= enough:
            break
        waiting.remove(lowest)
        parts = halves(lowest.motions, *width)
        found = [leaf(part) for part in parts] if parts is not None else []
        if found and min(one.bound for one in found) >= lowest.bound + _WORTH * enough:
            waiting += found
        else:
            whole.append(lowest)
    return whole + waiting


def narrow_first(leaves: Sequence[Leaf]) -> list[int]:
    """Places of tubes: those about few motions first, then those with low bounds."""
    return sorted(range(len(leaves)), key=lambda k: (len(leaves[k].motions), leaves[k].bound))


def halves(state: Array, angles: Array, spin: Array) -> tuple[Array, Array] | None:
    """Motions (M, N + 1, 12) in two parts, each with one of the two that are farthest apart.

    angles, spin: (3,) units of distance. None if all are within one of these of each other.
    """
    unit = np.concatenate([angles, spin])
    turned = np.concatenate([state[:, :-1, ANGLES], state[:, :-1, SPIN]], axis=-1) / unit
    apart = np.abs(turned[:, None] - turned[None]).max(axis=(2, 3))
    one, other = np.unravel_index(int(apart.argmax()), apart.shape)
    if apart[one, other] <= 1.0:
        return None
    nearer = apart[one] <= apart[other]
    return state[nearer], state[~nearer]
