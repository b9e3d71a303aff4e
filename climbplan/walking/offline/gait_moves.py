"""The neighbourhood of a gait in local search: flipped contacts, shifted phases, other regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import BoolArray, IntArray
from climbplan.robots.leg_order import alternating, mirror_legs
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import Gait

_NUM_NEIGHBOURS = 4  # regions that a foothold may go to in one move


def list_contact_moves(contact: BoolArray) -> list[BoolArray]:
    """Return all contacts (N + 1, L) that are one move away."""
    knots, legs, moves = len(contact), contact.shape[1], []
    groups = _list_leg_groups(legs)
    for n in range(knots):
        for leg in range(legs):
            moves.append(_flip_contacts(contact, [n], [leg]))
        for group in groups:
            moves.append(_flip_contacts(contact, [n], group))
        moves.append(_flip_contacts(contact, [n], list(range(legs))))
    for n in range(knots - 1):
        for leg in range(legs):
            moves.append(_flip_contacts(contact, [n, n + 1], [leg]))
        swapped = contact.copy()
        swapped[[n, n + 1]] = contact[[n + 1, n]]
        moves.append(swapped)
    moves.append(np.concatenate([contact[1:], contact[-1:]]))
    moves.append(np.concatenate([contact[:1], contact[:-1]]))
    moves.append(contact[:, mirror_legs(legs)])
    return moves


def generate_region_moves(
    gait: Gait, neighbours: Sequence[IntArray], allowed: BoolArray | None = None
) -> Iterator[Gait]:
    """Yield gaits with the same contacts and one stance phase on a neighbouring region.

    Args:
        gait: The gait.
        neighbours: Neighbouring regions, by region.
        allowed: (S, L) leg may stand on region; empty or None: all may.
    """
    for n in range(1, len(gait.contact)):
        for leg in range(gait.contact.shape[1]):
            if gait.contact[n, leg] and not gait.contact[n - 1, leg]:
                for region in neighbours[gait.region[n, leg]]:
                    if allowed is not None and allowed.size and not allowed[region, leg]:
                        continue
                    changed = gait.region.copy()
                    changed[n, leg] = region
                    yield build_gait(gait.contact, changed)


def find_neighbour_regions(ground: Ground) -> list[IntArray]:
    """Return a few regions nearest to each region, nearest first."""
    low, high = ground.lower, ground.upper
    gap = np.maximum(low[:, None] - high[None], low[None] - high[:, None])  # (S, S, 2)
    distance = np.linalg.norm(np.maximum(gap, 0.0), axis=-1)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")[:, : min(_NUM_NEIGHBOURS, ground.count - 1)]
    return [row.astype(np.int64) for row in order]


def _list_leg_groups(legs: int) -> list[list[int]]:
    """Return groups of legs that step together: alternating halves, and pairs front to hind."""
    halves = [np.flatnonzero(alternating(legs) == half).tolist() for half in (0, 1)]
    return halves + [[first, first + 1] for first in range(0, legs, 2)]


def _flip_contacts(contact: BoolArray, knots: list[int], legs: list[int]) -> BoolArray:
    """Return the contacts with those of some knots and legs inverted."""
    result = contact.copy()
    result[np.ix_(knots, legs)] ^= True
    return result
