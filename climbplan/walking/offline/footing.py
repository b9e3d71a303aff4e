"""Where toes are, given the integers: stance phases, fixed and free footholds, swinging toes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.footing import stance_phases
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import Gait

UNKNOWN = -np.inf  # [m]


@dataclass(frozen=True)
class Footing:
    """Footholds of a gait of N intervals; those after the first lift-off are free."""

    foothold: IntArray  # (N + 1, L) index of the free foothold, HELD or SWINGING
    leg: IntArray  # (F,) of each free foothold
    first: IntArray  # (F,) knot at which it is reached
    last: IntArray  # (F,) last knot at which it is stood on
    region: IntArray  # (F,)

    @property
    def count(self) -> int:
        """Free footholds."""
        return len(self.leg)


def footing_of(gait: Gait) -> Footing:
    """Stance phases of a gait, leg by leg."""
    foothold, phases = stance_phases(gait.contact)
    legs, firsts, lasts = phases.T
    return Footing(foothold, legs, firsts, lasts, gait.region[firsts, legs])


def gait_of(contact: BoolArray, region: IntArray) -> Gait:
    """A gait whose regions are constant while a leg stands and, before that, those it goes to.

    region (N + 1, L): only entries at the first knot of a stance phase count, and those of knot 0.
    """
    tidy = np.array(region, np.int64)
    for leg in range(contact.shape[1]):
        for n in range(1, len(contact)):
            if contact[n, leg] and contact[n - 1, leg]:
                tidy[n, leg] = tidy[n - 1, leg]
        for n in range(len(contact) - 2, 0, -1):
            if not contact[n, leg]:
                tidy[n, leg] = tidy[n + 1, leg]
    return Gait(np.array(contact, bool), tidy)


def toe_heights(ground: Ground, gait: Gait, lift: float) -> Array:
    """Heights of all toes (N + 1, L) [m]: on their regions, or lifted above ground, eq. (8.23).

    Of level regions; of sloped ones those at their middles, and of lifted toes `UNKNOWN` before it
    is known where they are.
    """
    if ground.slope.any():
        return np.where(gait.contact, ground.height[gait.region], UNKNOWN)
    clear = ground.clearance_height(gait.region) + lift
    return np.where(gait.contact, ground.height[gait.region], clear)
