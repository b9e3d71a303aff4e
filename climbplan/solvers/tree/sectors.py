"""Divide many alternatives into sectors around the point of a relaxation.

Along a row direction an alternative lies beyond the point, before it, or on both sides of it. The
hulls of those beyond and before exclude the point, so each of them is a child with a certain gain.
Those on both sides are divided along a second direction. Alternatives near the point in both
directions remain: few become children of their own, more stay together.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.tree.choice_table import ChoiceTable, Divisions, Mask

_NUM_DIRECTIONS = (
    4  # first directions that are tried, those with the fewest alternatives on both sides
)
_SINGLE = 4  # largest number of near alternatives that become children of their own
_CLEAR = 1e-9


def split_by_sectors(table: ChoiceTable, mask: Mask, point: Array) -> Divisions:
    """Return divisions of a set of at least two alternatives around a point."""
    members = table.list_members(mask)
    low, high = table.lower[members], table.upper[members]
    is_beyond, is_before = low > point + _CLEAR, high < point - _CLEAR  # (m, D)
    is_on_both_sides = ~(is_beyond | is_before)
    divisions: list[list[IntArray]] = []
    for d in np.argsort(is_on_both_sides.sum(axis=0), kind="stable")[:_NUM_DIRECTIONS]:
        is_near = is_on_both_sides[:, d]
        second = int(np.argmin((is_on_both_sides & is_near[:, None]).sum(axis=0)))
        sectors = [
            is_beyond[:, d],
            is_before[:, d],
            is_near & is_beyond[:, second],
            is_near & is_before[:, second],
        ]
        division = [np.flatnonzero(sector) for sector in sectors]
        remaining = np.flatnonzero(is_near & is_on_both_sides[:, second])
        division += [np.array([r]) for r in remaining] if len(remaining) <= _SINGLE else [remaining]
        division = [sector for sector in division if len(sector)]
        if len(division) > 1:
            divisions.append(division)
    if not divisions:
        divisions = (
            [_split_individually(members)]
            if len(members) <= 2 * _SINGLE
            else [_split_at_median(low, high)]
        )
    children = [[members[sector] for sector in division] for division in divisions]
    flat = [child for division in children for child in division]
    masks = [_encode_mask(child) for child in flat]
    hulls = [table.compute_hull(child) for child in masks]
    return Divisions(
        tuple(masks),
        np.cumsum([0, *(len(division) for division in children[:-1])]),
        np.array([h[0] for h in hulls]).reshape(len(masks), -1),
        np.array([h[1] for h in hulls]).reshape(len(masks), -1),
    )


def _split_individually(members: IntArray) -> list[IntArray]:
    """Return every alternative as a child."""
    return [np.array([k]) for k in range(len(members))]


def _split_at_median(low: Array, high: Array) -> list[IntArray]:
    """Return two halves along the direction in which the centers are spread most."""
    center = low + high
    if not center.shape[1]:
        return _split_individually(np.arange(len(center)))
    order = np.argsort(center[:, int(np.argmax(np.ptp(center, axis=0)))], kind="stable")
    return [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]


def _encode_mask(members: IntArray) -> Mask:
    """Return a set of alternatives as a bit mask."""
    flags = np.zeros(int(members.max()) + 1, bool)
    flags[members] = True
    return int.from_bytes(np.packbits(flags, bitorder="little").tobytes(), "little")
