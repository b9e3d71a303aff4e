"""Footholds of a gait: stance phases, fixed and free footholds, heights of toes.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.contact_phases import find_stance_phases
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import Gait

UNKNOWN = -np.inf  # [m]


@dataclass(frozen=True)
class Footing:
    """The stance phases of a gait of N intervals; footholds after the first lift-off are free."""

    foothold: IntArray  # (N + 1, L) index of the free foothold, HELD or SWINGING
    leg: IntArray  # (F,) of each free foothold
    first: IntArray  # (F,) knot at which it is reached
    last: IntArray  # (F,) last knot at which it is stood on
    region: IntArray  # (F,)

    @property
    def count(self) -> int:
        """Number of free footholds."""
        return len(self.leg)


def build_footing(gait: Gait) -> Footing:
    """Return the stance phases of a gait, leg by leg."""
    foothold, phases = find_stance_phases(gait.contact)
    legs, firsts, lasts = phases.T
    return Footing(foothold, legs, firsts, lasts, gait.region[firsts, legs])


def build_gait(contact: BoolArray, region: IntArray) -> Gait:
    """Return a gait whose regions are constant during each stance phase and the swing before it.

    Args:
        contact: Contacts (N + 1, L).
        region: Regions (N + 1, L). Only entries at knot 0 and at the first knot of a stance phase
            count.
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


def compute_toe_heights(ground: Ground, gait: Gait, lift: float) -> Array:
    """Return the heights of all toes (N + 1, L) [m], eq. (8.23).

    Standing toes are on their regions, on a slope at the middle of the region. Swinging toes are
    lifted above the ground; on slopes their height is `UNKNOWN` until their place is known.

    Args:
        ground: The regions.
        gait: The gait of N intervals.
        lift: Clearance of swinging toes [m].
    """
    if ground.slope.any():
        return np.where(gait.contact, ground.height[gait.region], UNKNOWN)
    clear = ground.compute_clearance_height(gait.region) + lift
    return np.where(gait.contact, ground.height[gait.region], clear)
