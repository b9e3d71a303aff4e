"""Where the centre of the box may be: convex blocks of free space, and ways through them.

Solids grow by half the box; what is left is covered by all largest blocks between their faces. A
cubic whose control points lie in one block stays in it, so that the way is free at every instant.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import product

import numpy as np

from climbplan.limms.scene import Array, Scene

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
    spans = [
        [(a, b) for a in range(size) for b in range(a + 1, size + 1)]
        for size in (len(middle) for middle in middles)
    ]
    # Summed-volume table: how many free cells a span of cells holds
    table = np.zeros(np.array(free.shape) + 1, int)
    table[1:, 1:, 1:] = free.cumsum(0).cumsum(1).cumsum(2)
    found = []
    for (a, b), (c, d), (e, f) in product(*spans):
        inside = sum(
            sign * table[i, j, k]
            for i, si in ((b, 1), (a, -1))
            for j, sj in ((d, 1), (c, -1))
            for k, sk in ((f, 1), (e, -1))
            for sign in (si * sj * sk,)
        )
        if inside == (b - a) * (d - c) * (f - e):
            found.append((a, b, c, d, e, f))
    spans_array = np.array(found)
    low, high = spans_array[:, ::2], spans_array[:, 1::2]
    largest = [
        k
        for k in range(len(found))
        if not (
            ((low <= low[k]) & (high >= high[k])).all(axis=1)
            & ((low < low[k]) | (high > high[k])).any(axis=1)
        ).any()
    ]
    return np.array(
        [
            [
                [edges[axis][low[k, axis]] for axis in range(3)],
                [edges[axis][high[k, axis]] for axis in range(3)],
            ]
            for k in largest
        ]
    )


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
