"""Legs of robots that walk: pairs from front to hind, of each the left leg first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

LEG_COUNTS = (4, 6, 8)


def order_in_pairs(places: Sequence[Sequence[float]]) -> list[int] | None:
    """Return the order of legs at places (x forward, y to the left, ...); None where they make no
    pairs.

    As many are on the left of their middle as on the right, and each pair is behind the one before.
    """
    middle = sum(place[1] for place in places) / len(places)
    by_side = [
        sorted((-place[0], leg) for leg, place in enumerate(places) if (place[1] > middle) == left)
        for left in (True, False)
    ]
    if len(by_side[0]) != len(by_side[1]):
        return None
    pairs = list(zip(*by_side, strict=True))
    for before, behind in pairwise(pairs):
        if max(before)[0] >= min(behind)[0]:
            return None
    return [leg for pair in pairs for _, leg in pair]
