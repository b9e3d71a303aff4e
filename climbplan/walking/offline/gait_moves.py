"""Moves of a search over gaits: flips of contacts, of knots and of legs, and other regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.walking.footing import gait_of
from climbplan.walking.ground import Ground
from climbplan.walking.offline.gaits import MIRROR
from climbplan.walking.task import LEGS, Flags, Gait, Whole

_BESIDE = 4  # regions that a foothold may go to in one move
_PAIRS = ((0, 3), (1, 2), (0, 1), (2, 3))  # diagonal, then fore and hind


def contact_moves(contact: Flags) -> list[Flags]:
    """All contacts (N + 1, 4) one move away."""
    knots, moves = len(contact), []
    for n in range(knots):
        for leg in range(LEGS):
            moves.append(_flipped(contact, [n], [leg]))
        for pair in _PAIRS:
            moves.append(_flipped(contact, [n], list(pair)))
        moves.append(_flipped(contact, [n], list(range(LEGS))))
    for n in range(knots - 1):
        for leg in range(LEGS):
            moves.append(_flipped(contact, [n, n + 1], [leg]))
        swapped = contact.copy()
        swapped[[n, n + 1]] = contact[[n + 1, n]]
        moves.append(swapped)
    moves.append(np.concatenate([contact[1:], contact[-1:]]))
    moves.append(np.concatenate([contact[:1], contact[:-1]]))
    moves.append(contact[:, MIRROR])
    return moves


def region_moves(gait: Gait, beside: Sequence[Whole]) -> Iterator[Gait]:
    """The same contacts with one stance phase on another region; beside: those next to each."""
    for n in range(1, len(gait.contact)):
        for leg in range(LEGS):
            if gait.contact[n, leg] and not gait.contact[n - 1, leg]:
                for region in beside[gait.region[n, leg]]:
                    changed = gait.region.copy()
                    changed[n, leg] = region
                    yield gait_of(gait.contact, changed)


def regions_beside(ground: Ground) -> list[Whole]:
    """The regions nearest to each, so many at most, nearest first."""
    low, high = ground.lower, ground.upper
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None])  # (S, S, 2)
    distance = np.linalg.norm(np.maximum(apart, 0.0), axis=-1)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")[:, : min(_BESIDE, ground.count - 1)]
    return [row.astype(np.int64) for row in order]


def _flipped(contact: Flags, knots: list[int], legs: list[int]) -> Flags:
    result = contact.copy()
    result[np.ix_(knots, legs)] ^= True
    return result
