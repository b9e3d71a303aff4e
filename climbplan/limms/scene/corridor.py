"""Where the box may be: convex blocks of free placements, and ways through them.

Solids grow by half the box; what is left is covered by all largest blocks between their faces. A
cubic whose control points lie in one block stays in it, so that the way is free at every instant.
A box that turns has such blocks for intervals of its yaw, grown by what it sweeps between them.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.placement import centre_of, extents, yaw_of

CLEARANCE = 5e-4  # [m] of the box from what is not the ground
TURN = np.pi / 4  # [rad] at most from one yaw that a box may be put down with to the next
_LEVER = 0.3  # [m/rad] of way that a turn counts as


@dataclass(frozen=True)
class Way:
    """Blocks to pass through (n, 2, D), and where to cross from one to the next (n - 1, D)."""

    blocks: Array
    crossings: Array


def yaws_between(scene: Scene) -> Array:
    """Yaws (n,) from start to goal of the first box that it may be put down with [rad]."""
    first, last = (float(yaw_of(place)) for place in (scene.start_place, scene.goal_place))
    if first == last:
        return np.array([first])
    steps = max(int(np.ceil(abs(last - first) / TURN - 1e-9)), 2)
    return np.linspace(first, last, steps + 1)


def centre_blocks(scene: Scene) -> Array:
    """Largest free blocks (n, 2, D) of placements of the box to deliver [m, rad]."""
    half = scene.box_size[0] / 2
    others = [
        extents(scene.box_size[b] / 2, scene.start_yaws[b], scene.start_yaws[b])
        for b in range(1, scene.boxes)
    ]
    if not scene.turns:
        return _free_blocks(scene, half, others)
    stands = yaws_between(scene)
    middles = (stands[1:] + stands[:-1]) / 2
    edges = np.sort(np.concatenate([stands, middles]))
    # Widest intervals first: of what sweeps no more than one in a wider one, that is enough
    spans = sorted(combinations_with_replacement(edges, 2), key=lambda span: span[0] - span[1])
    kept: list[tuple[float, float, Array]] = []
    for least, most in spans:
        swept = extents(half, least, most)
        if not any(a <= least and most <= b and (c <= swept + 1e-9).all() for a, b, c in kept):
            kept.append((least, most, swept))
    found = []
    for least, most, swept in kept:
        blocks = _free_blocks(scene, swept, others)
        span = np.broadcast_to(np.array([least, most])[:, None], (len(blocks), 2, 1))
        found.append(np.concatenate([blocks, span], axis=2))
    return np.concatenate(found)


def inner_blocks(scene: Scene) -> Array:
    """Blocks (n, 2, 3) that hold every free centre of the first box, however it turns [m]."""
    half, others = scene.box_size[0] / 2, list(scene.box_size[1:] / 2)
    if scene.turns:
        half = _inner(half)
    others = [
        _inner(each) if yaw else each
        for each, yaw in zip(others, scene.start_yaws[1:], strict=True)
    ]
    return _free_blocks(scene, half, others)


def _inner(half: Array) -> Array:
    """Half edges (3,) of an axis-parallel block that is in the box however it is turned.

    The cylinder in the box is; blocks are what is tested, so that it is the one in the cylinder.
    """
    side = float(min(half[0], half[1])) / np.sqrt(2)
    return np.array([side, side, half[2]])


def _free_blocks(scene: Scene, half: Array, others: list[Array]) -> Array:
    """Largest free blocks (n, 2, 3) of centres of an upright block, half its edges (3,) [m].

    others: half the edges (3,) of the blocks that the other boxes are in.
    """
    grown = [np.array([low - half, high + half]) for low, high in scene.solids]
    for b, own in enumerate(others, 1):
        extent = own + half + CLEARANCE
        grown.append(np.array([scene.box_start[b] - extent, scene.box_start[b] + extent]))
    solids = np.array(grown)
    inner = np.array([scene.solids[:, 0].min(axis=0), scene.solids[:, 1].max(axis=0)])
    edges = [
        np.unique(np.clip(np.concatenate([solids[:, :, axis].ravel()]), *inner[:, axis]))
        for axis in range(3)
    ]
    middles = [(e[:-1] + e[1:]) / 2 for e in edges]
    grid = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    taken = np.zeros(grid.shape[:3], bool)
    for low, high in solids:
        taken |= ((grid > low) & (grid < high)).all(axis=-1)
    free = ~taken
    # Summed-volume table: how many free cells a span of cells holds
    table = np.zeros(np.array(free.shape) + 1, int)
    table[1:, 1:, 1:] = free.cumsum(0).cumsum(1).cumsum(2)
    counts: tuple[int, ...] = free.shape
    spans = [np.array(np.triu_indices(count + 1, 1)) for count in counts]  # (2, spans)
    for axis, (first, last) in enumerate(spans):
        table = np.take(table, last, axis=axis) - np.take(table, first, axis=axis)
    lengths = [last - first for first, last in spans]
    whole = table == lengths[0][:, None, None] * lengths[1][:, None] * lengths[2]
    found = np.argwhere(whole)
    low, high = (
        np.stack([spans[axis][end][found[:, axis]] for axis in range(3)], axis=1) for end in (0, 1)
    )
    largest = _largest(low, high)
    return np.array(
        [
            [
                [edges[axis][low[k, axis]] for axis in range(3)],
                [edges[axis][high[k, axis]] for axis in range(3)],
            ]
            for k in largest
        ]
    )


def _largest(low: IntArray, high: IntArray) -> list[int]:
    """Which free spans of cells are in no larger one: beside each face something is taken.

    low: (n, 3) first cells; high: (n, 3) those after the last.
    """
    found = set(map(tuple, np.hstack([low, high]).tolist()))
    kept = []
    for number, span in enumerate(np.hstack([low, high]).tolist()):
        wider = [
            tuple(value + step * (index == place) for index, value in enumerate(span))
            for place, step in ((0, -1), (1, -1), (2, -1), (3, 1), (4, 1), (5, 1))
        ]
        if not any(other in found for other in wider):
            kept.append(number)
    return kept


def way_length(first: Array, last: Array) -> Array:
    """How long straight ways (...) between placements (..., D) are, turns counted in [m]."""
    change = last - first
    turned: Array = np.hypot(np.linalg.norm(centre_of(change), axis=-1), _LEVER * yaw_of(change))
    return turned


def ways(blocks: Array, start: Array, goal: Array) -> Way | None:
    """The shortest chain of overlapping blocks from start to goal, by straight pieces; or None."""
    inside = [
        [bool((b[0] - 1e-9 <= p).all() and (p <= b[1] + 1e-9).all()) for b in blocks]
        for p in (start, goal)
    ]
    queue: list[tuple[float, float, int, tuple[int, ...], tuple[tuple[float, ...], ...]]] = []
    for k in (k for k, holds in enumerate(inside[0]) if holds):
        heapq.heappush(queue, (float(way_length(start, goal)), 0.0, int(k), (int(k),), ()))
    closed: dict[int, float] = {}
    while queue:
        _, cost, k, chain, crossings = heapq.heappop(queue)
        if inside[1][k]:
            return Way(blocks[list(chain)], np.array(crossings, float).reshape(-1, len(start)))
        if closed.get(k, np.inf) <= cost:
            continue
        closed[k] = cost
        here = np.array(crossings[-1]) if crossings else start
        for other in range(len(blocks)):
            if other in chain:
                continue
            low = np.maximum(blocks[k][0], blocks[other][0])
            high = np.minimum(blocks[k][1], blocks[other][1])
            # Through a face without width no box goes; at one yaw it may
            if (high - low < 1e-6)[:3].any() or (high < low)[3:].any():
                continue
            cross = np.clip((here + goal) / 2, low, high)
            ahead = cost + float(way_length(here, cross)) + 0.05
            left = float(way_length(cross, goal))
            step = (ahead + left, ahead, other, (*chain, other), (*crossings, tuple(cross)))
            heapq.heappush(queue, step)
    return None
