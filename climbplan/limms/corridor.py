"""Where the centre of the box may be: convex blocks of free space, and ways through them.

Solids grow by half the box; what is left is covered by all largest blocks between their faces. A
cubic whose control points lie in one block stays in it, so that the way is free at every instant.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from climbplan.limms.scene import Array, Index, Scene

CLEARANCE = 5e-4  # [m] of the box from what is not the ground


@dataclass(frozen=True)
class Way:
    """Blocks to pass through (n, 2, 3), and where to cross from one to the next (n - 1, 3)."""

    blocks: Array
    crossings: Array


def centre_blocks(scene: Scene) -> Array:
    """Largest free blocks (n, 2, 3) of the centre of the box to deliver [m]."""
    half = scene.box_size[0] / 2
    grown = [np.array([low - half, high + half]) for low, high in scene.solids]
    for b in range(1, scene.boxes):
        extent = scene.box_size[b] / 2 + half + CLEARANCE
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


def _largest(low: Index, high: Index) -> list[int]:
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


def ways(blocks: Array, start: Array, goal: Array) -> Way | None:
    """The shortest chain of overlapping blocks from start to goal, by straight pieces; or None."""
    inside = [
        [bool((b[0] - 1e-9 <= p).all() and (p <= b[1] + 1e-9).all()) for b in blocks]
        for p in (start, goal)
    ]
    queue: list[tuple[float, float, int, tuple[int, ...], tuple[tuple[float, ...], ...]]] = []
    for k in (k for k, holds in enumerate(inside[0]) if holds):
        heapq.heappush(queue, (float(np.linalg.norm(goal - start)), 0.0, int(k), (int(k),), ()))
    closed: dict[int, float] = {}
    while queue:
        _, cost, k, chain, crossings = heapq.heappop(queue)
        if inside[1][k]:
            return Way(blocks[list(chain)], np.array(crossings, float).reshape(-1, 3))
        if closed.get(k, np.inf) <= cost:
            continue
        closed[k] = cost
        here = np.array(crossings[-1]) if crossings else start
        for other in range(len(blocks)):
            if other in chain:
                continue
            low = np.maximum(blocks[k][0], blocks[other][0])
            high = np.minimum(blocks[k][1], blocks[other][1])
            if (high - low < 1e-6).any():
                continue
            cross = np.clip((here + goal) / 2, low, high)
            ahead = cost + float(np.linalg.norm(cross - here)) + 0.05
            left = float(np.linalg.norm(goal - cross))
            step = (ahead + left, ahead, other, (*chain, other), (*crossings, tuple(cross)))
            heapq.heappush(queue, step)
    return None
