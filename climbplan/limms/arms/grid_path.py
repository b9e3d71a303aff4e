"""Paths of the box that arms can follow, searched on a grid where the straight path fails.

The straight path may pass where a joint range ends, a link collides or a roll would have to jump.
In one branch of the inverse kinematics, a node of the grid is feasible if all arms reach it, are in
range and clear. Neighbours are connected if their joints are close. The shortest path (Dijkstra
1959) is an initial guess of a program; its absence proves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from operator import add

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.arms.branch_choices import (
    RANGE_MARGIN,
    HeldTask,
    compute_clearance,
    is_off_singular,
)
from climbplan.limms.modules.chain import range_excess
from climbplan.limms.modules.limbs import compute_limb_angles
from climbplan.limms.scene.corridor import decompose_free_space, path_length
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule

NODE_SPACING = 0.07  # [m] between nodes
SEARCH_MARGIN = 0.35  # [m] around start and goal
YAW_STEP = 0.4  # [rad] between nodes at most
MAX_JOINT_STEP = 0.7  # [rad] between neighbours
_TOUCH_TOLERANCE = 1e-6  # [m]; arms touch the box and their anchors
_JOINT_WEIGHT = 0.05  # [m/rad] of joint steps in path costs


def find_grid_path(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask
) -> list[tuple[Array, Array]]:
    """Find pieces (n, D) of a path, each with its free block (2, D); empty if there is none.

    The limbs keep their branches along the path.
    """
    nodes, grid_coordinates = _build_nodes(task)
    blocks = decompose_free_space(scene)
    is_in_block = _find_blocks(nodes, blocks)  # (n, blocks)
    is_feasible: BoolArray = np.asarray(is_in_block.any(axis=1))
    angles = np.zeros((len(nodes), len(limbs), 6))
    for i, limb in enumerate(limbs):
        feet = np.broadcast_to(limb.fixed_position, (len(nodes), 3))
        angles[:, i], reach_error = compute_limb_angles(scene, limb, nodes, feet, limb.branch)
        wrapped = (angles[:, i] + np.pi) % (2 * np.pi) - np.pi
        is_feasible &= (reach_error <= 0) & (range_excess(scene.module, wrapped, RANGE_MARGIN) <= 0)
        is_feasible &= is_off_singular(scene.module, angles[:, i])
    is_feasible[:2] = True  # start and goal always belong to the graph
    feasible = np.flatnonzero(is_feasible)
    feet = np.broadcast_to([limb.fixed_position for limb in limbs], (len(feasible), len(limbs), 3))
    gap = compute_clearance(scene, limbs, nodes[feasible], feet, angles[feasible])
    feasible = feasible[(gap >= -_TOUCH_TOLERANCE) | (feasible < 2)]
    path = _find_shortest_path(
        nodes[feasible],
        grid_coordinates[feasible],
        angles[feasible].reshape(len(feasible), -1),
        is_in_block[feasible],
    )
    if path is None:
        return []
    return _split_by_blocks(nodes[feasible][path], is_in_block[feasible][path], blocks)


def _build_nodes(task: HeldTask) -> tuple[Array, Array]:
    """Return start, goal and a grid around both (n, D) [m, rad], and their grid coordinates."""
    ends = np.array([task.start, task.goal])
    low, high = ends.min(axis=0), ends.max(axis=0)
    spans = [
        np.arange(a - SEARCH_MARGIN, b + SEARCH_MARGIN + NODE_SPACING, NODE_SPACING)
        for a, b in zip(low, high, strict=True)
    ]
    first, steps = low - SEARCH_MARGIN, np.full(len(low), NODE_SPACING)
    if len(low) == 4:  # yaws only between start and goal
        count = int(np.ceil((high[3] - low[3]) / YAW_STEP - 1e-9))
        spans[3] = np.linspace(low[3], high[3], count + 1)
        first[3], steps[3] = low[3], (high[3] - low[3]) / count if count else 1.0
    grid = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, len(low))
    nodes = np.vstack([ends, grid])
    return nodes, (nodes - first) / steps


def _find_blocks(points: Array, blocks: Array) -> BoolArray:
    """Return which points are in which blocks, bool (n, blocks)."""
    above = points[:, None] >= blocks[:, 0] - 1e-9
    return np.asarray((above & (points[:, None] <= blocks[:, 1] + 1e-9)).all(axis=2))


def _find_shortest_path(
    nodes: Array, grid_coordinates: Array, angles: Array, is_in_block: BoolArray
) -> IntArray | None:
    """Return the shortest path from the first node to the second through common blocks, or None."""
    pairs = _find_neighbours(grid_coordinates)
    first, second = pairs.T
    joint_step = np.abs((angles[first] - angles[second] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    is_edge = (is_in_block[first] & is_in_block[second]).any(axis=1) & (
        joint_step <= MAX_JOINT_STEP
    )
    first, second, joint_step = first[is_edge], second[is_edge], joint_step[is_edge]
    cost = path_length(nodes[first], nodes[second]) + _JOINT_WEIGHT * joint_step
    graph = coo_array((cost, (first, second)), shape=(len(nodes), len(nodes))).tocsr()
    length, predecessors = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(length[1]):
        return None
    order = [1]
    while order[-1] != 0:
        order.append(int(predecessors[order[-1]]))
    return np.array(order[::-1])


def _find_neighbours(grid_coordinates: Array) -> IntArray:
    """Return pairs (m, 2) of nodes at most one step apart along each axis."""
    if len(grid_coordinates) < 3:
        return np.zeros((0, 2), np.int64)
    size = grid_coordinates.shape[1]
    cells_of_nodes = np.round(grid_coordinates[2:] - grid_coordinates[2:].min(axis=0)).astype(int)
    cells = {tuple(cell): k + 2 for k, cell in enumerate(cells_of_nodes.tolist())}
    shifts = [s for s in product((-1, 0, 1), repeat=size) if s > (0,) * size]
    pairs = []
    for cell, k in cells.items():
        for shift in shifts:
            neighbour = cells.get(tuple(map(add, cell, shift)))
            if neighbour is not None:
                pairs.append((k, neighbour))
    for end in (0, 1):
        close = np.flatnonzero(
            np.abs(grid_coordinates - grid_coordinates[end]).max(axis=1) <= 1 + 1e-9
        )
        pairs += [(end, int(k)) for k in close if k != end]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _split_by_blocks(
    path: Array, is_in_block: BoolArray, blocks: Array
) -> list[tuple[Array, Array]]:
    """Return the path split between blocks, each block kept as long as possible."""
    pieces, start = [], 0
    while start < len(path) - 1:
        lengths = [_count_leading(is_in_block[start:, block]) for block in range(len(blocks))]
        block = int(np.argmax(lengths))
        end = start + lengths[block] - 1
        if end <= start:
            return []  # not reachable, since neighbours share a block
        pieces.append((path[start : end + 1], blocks[block]))
        start = end
    return pieces


def _count_leading(mask: BoolArray) -> int:
    """Return the number of leading true values."""
    return int(len(mask) if mask.all() else np.argmin(mask))
