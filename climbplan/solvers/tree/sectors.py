"""Dividing many alternatives by where they lie round the point of a relaxation.

Seen along a row direction an alternative lies beyond the point, before it, or on both sides of it.
Those beyond and before have hulls that the point is not in, so that each is a child with a sure
gain; those on both sides are divided along a second direction. What is near the point in both
stays: few as children of their own, more together.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.choice_table import ChoiceTable, Mask, Splits

_WAYS = 4  # first directions that are tried, those with the fewest alternatives on both sides
_SINGLE = 4  # so many near ones become children of their own
_CLEAR = 1e-9


def sector_splits(table: ChoiceTable, mask: Mask, point: Array) -> Splits:
    """Ways to divide a set of at least two alternatives about a point, given along directions."""
    members = table.members(mask)
    low, high = table.lower[members], table.upper[members]
    beyond, before = low > point + _CLEAR, high < point - _CLEAR  # (m, D)
    both = ~(beyond | before)
    ways: list[list[IntArray]] = []
    for d in np.argsort(both.sum(axis=0), kind="stable")[:_WAYS]:
        near = both[:, d]
        second = int(np.argmin((both & near[:, None]).sum(axis=0)))
        parts = [
            beyond[:, d],
            before[:, d],
            near & beyond[:, second],
            near & before[:, second],
        ]
        way = [np.flatnonzero(part) for part in parts]
        rest = np.flatnonzero(near & both[:, second])
        way += [np.array([r]) for r in rest] if len(rest) <= _SINGLE else [rest]
        way = [part for part in way if len(part)]
        if len(way) > 1:
            ways.append(way)
    if not ways:
        ways = [_each(members)] if len(members) <= 2 * _SINGLE else [_halves(low, high)]
    children = [[members[part] for part in way] for way in ways]
    flat = [child for way in children for child in way]
    masks = [_mask(child) for child in flat]
    hulls = [table.hull(child) for child in masks]
    return Splits(
        tuple(masks),
        np.cumsum([0, *(len(way) for way in children[:-1])]),
        np.array([h[0] for h in hulls]).reshape(len(masks), -1),
        np.array([h[1] for h in hulls]).reshape(len(masks), -1),
    )


def _each(members: IntArray) -> list[IntArray]:
    return [np.array([k]) for k in range(len(members))]


def _halves(low: Array, high: Array) -> list[IntArray]:
    """Two halves along the direction in which the middles are spread most."""
    middle = low + high
    if not middle.shape[1]:
        return _each(np.arange(len(middle)))
    order = np.argsort(middle[:, int(np.argmax(np.ptp(middle, axis=0)))], kind="stable")
    return [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]


def _mask(members: IntArray) -> Mask:
    flags = np.zeros(int(members.max()) + 1, bool)
    flags[members] = True
    return int.from_bytes(np.packbits(flags, bitorder="little").tobytes(), "little")
