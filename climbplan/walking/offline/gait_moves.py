"""Moves of a search over gaits: flips of contacts, of knots and of legs, and other regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import BoolArray, IntArray
from climbplan.robots.leg_order import alternating, mirror_legs
from climbplan.walking.offline.footing import gait_of
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import Gait

_BESIDE = 4  # regions that a foothold may go to in one move


def contact_moves(contact: BoolArray) -> list[BoolArray]:
    """All contacts (N + 1, L) one move away."""
    knots, legs, moves = len(contact), contact.shape[1], []
    together = _together(legs)
    for n in range(knots):
        for leg in range(legs):
            moves.append(_flipped(contact, [n], [leg]))
        for group in together:
            moves.append(_flipped(contact, [n], group))
        moves.append(_flipped(contact, [n], list(range(legs))))
    for n in range(knots - 1):
        for leg in range(legs):
            moves.append(_flipped(contact, [n, n + 1], [leg]))
        swapped = contact.copy()
        swapped[[n, n + 1]] = contact[[n + 1, n]]
        moves.append(swapped)
    moves.append(np.concatenate([contact[1:], contact[-1:]]))
    moves.append(np.concatenate([contact[:1], contact[:-1]]))
    moves.append(contact[:, mirror_legs(legs)])
    return moves


def region_moves(gait: Gait, beside: Sequence[IntArray]) -> Iterator[Gait]:
    """The same contacts with one stance phase on another region; beside: those next to each."""
    for n in range(1, len(gait.contact)):
        for leg in range(gait.contact.shape[1]):
            if gait.contact[n, leg] and not gait.contact[n - 1, leg]:
                for region in beside[gait.region[n, leg]]:
                    changed = gait.region.copy()
                    changed[n, leg] = region
                    yield gait_of(gait.contact, changed)


def regions_beside(ground: Ground) -> list[IntArray]:
    """The regions nearest to each, so many at most, nearest first."""
    low, high = ground.lower, ground.upper
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None])  # (S, S, 2)
    distance = np.linalg.norm(np.maximum(apart, 0.0), axis=-1)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")[:, : min(_BESIDE, ground.count - 1)]
    return [row.astype(np.int64) for row in order]


def _together(legs: int) -> list[list[int]]:
    """Legs that step together: halves that alternate, then pairs from front to hind."""
    halves = [np.flatnonzero(alternating(legs) == half).tolist() for half in (0, 1)]
    return halves + [[first, first + 1] for first in range(0, legs, 2)]


def _flipped(contact: BoolArray, knots: list[int], legs: list[int]) -> BoolArray:
    result = contact.copy()
    result[np.ix_(knots, legs)] ^= True
    return result
