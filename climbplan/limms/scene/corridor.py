"""Free space of the box as convex blocks of placements, and corridors through them.

Solids are inflated by half the box (Minkowski sum); the rest is covered by all maximal blocks
between faces. A cubic whose Bezier control points lie in one block stays in it, so the path is free
at every instant. For a box with a yaw, there are such blocks for intervals of the yaw, inflated by
the swept extents of the box.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.placement import centre_of, swept_half_extents, yaw_of

CLEARANCE = 5e-4  # [m] between the box and other boxes
MAX_YAW_STEP = np.pi / 4  # [rad] between two neighbouring yaws of standing boxes
_YAW_WEIGHT = 0.3  # [m/rad] weight of yaw in path lengths


@dataclass(frozen=True)
class Corridor:
    """A safe corridor: convex blocks to pass through, and the points that connect them."""

    blocks: Array  # (n, 2, D) lower and upper corners [m, rad]
    crossings: Array  # (n - 1, D) [m, rad]


def list_standing_yaws(scene: ModuleScene) -> Array:
    """Return the yaws (n,) from start to goal with which the first box may be put down [rad]."""
    first, last = (float(yaw_of(place)) for place in (scene.start_placement, scene.goal_placement))
    if first == last:
        return np.array([first])
    steps = max(int(np.ceil(abs(last - first) / MAX_YAW_STEP - 1e-9)), 2)
    return np.linspace(first, last, steps + 1)


def decompose_free_space(scene: ModuleScene) -> Array:
    """Return the maximal free blocks (n, 2, D) of placements of the first box [m, rad]."""
    half = scene.box_size[0] / 2
    obstacle_extents = [
        swept_half_extents(scene.box_size[b] / 2, scene.start_yaws[b], scene.start_yaws[b])
        for b in range(1, scene.num_boxes)
    ]
    if not scene.uses_yaw:
        return _find_maximal_blocks(scene, half, obstacle_extents)
    standing_yaws = list_standing_yaws(scene)
    middles = (standing_yaws[1:] + standing_yaws[:-1]) / 2
    edges = np.sort(np.concatenate([standing_yaws, middles]))
    # Widest intervals first: a narrower one with no smaller sweep adds nothing
    yaw_intervals = sorted(
        combinations_with_replacement(edges, 2),
        key=lambda yaw_bounds: yaw_bounds[0] - yaw_bounds[1],
    )
    selected: list[tuple[float, float, Array]] = []
    for min_yaw, max_yaw in yaw_intervals:
        swept = swept_half_extents(half, min_yaw, max_yaw)
        if not any(
            a <= min_yaw and max_yaw <= b and (c <= swept + 1e-9).all() for a, b, c in selected
        ):
            selected.append((min_yaw, max_yaw, swept))
    pieces = []
    for min_yaw, max_yaw, swept in selected:
        blocks = _find_maximal_blocks(scene, swept, obstacle_extents)
        yaw_bounds = np.broadcast_to(np.array([min_yaw, max_yaw])[:, None], (len(blocks), 2, 1))
        pieces.append(np.concatenate([blocks, yaw_bounds], axis=2))
    return np.concatenate(pieces)


def decompose_relaxed_free_space(scene: ModuleScene) -> Array:
    """Return blocks (n, 2, 3) that contain every free centre of the first box, at any yaw [m]."""
    half, obstacle_extents = scene.box_size[0] / 2, list(scene.box_size[1:] / 2)
    if scene.uses_yaw:
        half = _inscribed_half_extents(half)
    obstacle_extents = [
        _inscribed_half_extents(each) if yaw else each
        for each, yaw in zip(obstacle_extents, scene.start_yaws[1:], strict=True)
    ]
    return _find_maximal_blocks(scene, half, obstacle_extents)


def _inscribed_half_extents(half: Array) -> Array:
    """Return half edges (3,) of an axis-parallel block inside the box at every yaw [m].

    The block lies in the inscribed cylinder, as collision tests take blocks only.
    """
    side = float(min(half[0], half[1])) / np.sqrt(2)
    return np.array([side, side, half[2]])


def _find_maximal_blocks(scene: ModuleScene, half: Array, obstacle_extents: list[Array]) -> Array:
    """Return the maximal free blocks (n, 2, 3) of centres of an upright block [m].

    Args:
        scene: The scene with its solids.
        half: Half edges (3,) of the moving block [m].
        obstacle_extents: Half edges (3,) of the blocks around the other boxes [m].
    """
    grown = [np.array([low - half, high + half]) for low, high in scene.solids]
    for b, obstacle_extent in enumerate(obstacle_extents, 1):
        extent = obstacle_extent + half + CLEARANCE
        grown.append(np.array([scene.box_start[b] - extent, scene.box_start[b] + extent]))
    solids = np.array(grown)
    inner = np.array([scene.solids[:, 0].min(axis=0), scene.solids[:, 1].max(axis=0)])
    edges = [
        np.unique(np.clip(np.concatenate([solids[:, :, axis].ravel()]), *inner[:, axis]))
        for axis in range(3)
    ]
    middles = [(e[:-1] + e[1:]) / 2 for e in edges]
    grid = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    is_occupied = np.zeros(grid.shape[:3], bool)
    for low, high in solids:
        is_occupied |= ((grid > low) & (grid < high)).all(axis=-1)
    is_free = ~is_occupied
    # Summed-volume table: the number of free cells in each span of cells
    table = np.zeros(np.array(is_free.shape) + 1, int)
    table[1:, 1:, 1:] = is_free.cumsum(0).cumsum(1).cumsum(2)
    counts: tuple[int, ...] = is_free.shape
    spans = [np.array(np.triu_indices(count + 1, 1)) for count in counts]  # (2, spans)
    for axis, (first, last) in enumerate(spans):
        table = np.take(table, last, axis=axis) - np.take(table, first, axis=axis)
    lengths = [last - first for first, last in spans]
    is_span_free = table == lengths[0][:, None, None] * lengths[1][:, None] * lengths[2]
    free_spans = np.argwhere(is_span_free)
    low, high = (
        np.stack([spans[axis][end][free_spans[:, axis]] for axis in range(3)], axis=1)
        for end in (0, 1)
    )
    largest = _select_maximal(low, high)
    return np.array(
        [
            [
                [edges[axis][low[k, axis]] for axis in range(3)],
                [edges[axis][high[k, axis]] for axis in range(3)],
            ]
            for k in largest
        ]
    )


def _select_maximal(low: IntArray, high: IntArray) -> list[int]:
    """Return the indices of free spans that no larger free span contains.

    Args:
        low: First cells of the spans (n, 3).
        high: Cells after the last of the spans (n, 3).
    """
    all_spans = set(map(tuple, np.hstack([low, high]).tolist()))
    maximal = []
    for number, span in enumerate(np.hstack([low, high]).tolist()):
        wider = [
            tuple(value + step * (index == entry) for index, value in enumerate(span))
            for entry, step in ((0, -1), (1, -1), (2, -1), (3, 1), (4, 1), (5, 1))
        ]
        if not any(span_wider in all_spans for span_wider in wider):
            maximal.append(number)
    return maximal


def path_length(first: Array, last: Array) -> Array:
    """Return the lengths (...) of straight paths between placements (..., D), yaw included [m]."""
    change = last - first
    length: Array = np.hypot(
        np.linalg.norm(centre_of(change), axis=-1), _YAW_WEIGHT * yaw_of(change)
    )
    return length


def find_corridor(blocks: Array, start: Array, goal: Array) -> Corridor | None:
    """Return the shortest chain of overlapping blocks from start to goal by A* search, or None.

    Args:
        blocks: Convex blocks (n, 2, D) [m, rad].
        start: Placement (D,) [m, rad].
        goal: Placement (D,) [m, rad].
    """
    inside = [
        [bool((b[0] - 1e-9 <= p).all() and (p <= b[1] + 1e-9).all()) for b in blocks]
        for p in (start, goal)
    ]
    queue: list[tuple[float, float, int, tuple[int, ...], tuple[tuple[float, ...], ...]]] = []
    for block in (block for block, contains_start in enumerate(inside[0]) if contains_start):
        heapq.heappush(queue, (float(path_length(start, goal)), 0.0, int(block), (int(block),), ()))
    closed: dict[int, float] = {}
    while queue:
        _, cost, block, chain, crossings = heapq.heappop(queue)
        if inside[1][block]:
            return Corridor(blocks[list(chain)], np.array(crossings, float).reshape(-1, len(start)))
        if closed.get(block, np.inf) <= cost:
            continue
        closed[block] = cost
        position = np.array(crossings[-1]) if crossings else start
        for neighbour in range(len(blocks)):
            if neighbour in chain:
                continue
            low = np.maximum(blocks[block][0], blocks[neighbour][0])
            high = np.minimum(blocks[block][1], blocks[neighbour][1])
            # Overlaps need a width in space; a single common yaw suffices
            if (high - low < 1e-6)[:3].any() or (high < low)[3:].any():
                continue
            cross = np.clip((position + goal) / 2, low, high)
            next_cost = cost + float(path_length(position, cross)) + 0.05
            remaining = float(path_length(cross, goal))
            node = (
                next_cost + remaining,
                next_cost,
                neighbour,
                (*chain, neighbour),
                (*crossings, tuple(cross)),
            )
            heapq.heappush(queue, node)
    return None
