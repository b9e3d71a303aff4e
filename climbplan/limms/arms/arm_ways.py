"""Ways of the box that arms can follow, searched on a grid where a straight one does not serve.

The straight way of a box may pass where a joint range ends, a link touches something or a roll
would have to turn at once. In one branch of the inverse kinematics, a node of the grid serves if
all arms reach, are in range and touch nothing there; neighbours are joined if their joints are
near. The shortest way (Dijkstra) is where a program may begin; it proves nothing if there is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from operator import add

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.arms.held_branches import RANGE_MARGIN, HeldTask, clearance, off_singular
from climbplan.limms.modules.chain import in_range
from climbplan.limms.modules.limbs import limb_angles
from climbplan.limms.scene.corridor import decompose_free_space, path_length
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb

STEP = 0.07  # [m] between nodes
AROUND = 0.35  # [m] round start and goal that is looked at
YAW_STEP = 0.4  # [rad] between nodes at most, of a box that turns
TURN = 0.7  # [rad] of a joint between neighbours
_TOUCH = 1e-6  # [m] arms touch the box and what they are latched to
_TURNING = 0.05  # [m/rad] of way that a turn counts as


def arm_way(scene: Scene, limbs: Sequence[Limb], task: HeldTask) -> list[tuple[Array, Array]]:
    """Pieces of a way (n, D) with the free block (2, D) that each is in; none where none is found.

    Limbs hold the box in their branches all along.
    """
    nodes, places = _nodes(task)
    blocks = decompose_free_space(scene)
    inside = _inside(nodes, blocks)  # (n, blocks)
    serves: BoolArray = np.asarray(inside.any(axis=1))
    angles = np.zeros((len(nodes), len(limbs), 6))
    for i, limb in enumerate(limbs):
        feet = np.broadcast_to(limb.fixed_position, (len(nodes), 3))
        angles[:, i], missing = limb_angles(scene, limb, nodes, feet, limb.branch)
        wrap_angle = (angles[:, i] + np.pi) % (2 * np.pi) - np.pi
        serves &= (missing <= 0) & (in_range(scene.module, wrap_angle, RANGE_MARGIN) <= 0)
        serves &= off_singular(scene.module, angles[:, i])
    serves[:2] = True  # start and goal are given
    at = np.flatnonzero(serves)
    feet = np.broadcast_to([limb.fixed_position for limb in limbs], (len(at), len(limbs), 3))
    gap = clearance(scene, limbs, nodes[at], feet, angles[at])
    at = at[(gap >= -_TOUCH) | (at < 2)]
    order = _shortest(nodes[at], places[at], angles[at].reshape(len(at), -1), inside[at])
    if order is None:
        return []
    return _pieces(nodes[at][order], inside[at][order], blocks)


def _nodes(task: HeldTask) -> tuple[Array, Array]:
    """Start, goal, and a grid round both (n, D) [m, rad]; where they are in the grid, in steps."""
    ends = np.array([task.start, task.goal])
    low, high = ends.min(axis=0), ends.max(axis=0)
    spans = [np.arange(a - AROUND, b + AROUND + STEP, STEP) for a, b in zip(low, high, strict=True)]
    first, steps = low - AROUND, np.full(len(low), STEP)
    if len(low) == 4:  # the yaw from start to goal, and no further
        count = int(np.ceil((high[3] - low[3]) / YAW_STEP - 1e-9))
        spans[3] = np.linspace(low[3], high[3], count + 1)
        first[3], steps[3] = low[3], (high[3] - low[3]) / count if count else 1.0
    grid = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, len(low))
    nodes = np.vstack([ends, grid])
    return nodes, (nodes - first) / steps


def _inside(points: Array, blocks: Array) -> BoolArray:
    """Which points are in which blocks (n, blocks)."""
    above = points[:, None] >= blocks[:, 0] - 1e-9
    return np.asarray((above & (points[:, None] <= blocks[:, 1] + 1e-9)).all(axis=2))


def _shortest(nodes: Array, places: Array, angles: Array, inside: BoolArray) -> IntArray | None:
    """The shortest way from the first node to the second, by neighbours in a common block."""
    pairs = _neighbours(places)
    first, second = pairs.T
    turned = np.abs((angles[first] - angles[second] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    joined = (inside[first] & inside[second]).any(axis=1) & (turned <= TURN)
    first, second, turned = first[joined], second[joined], turned[joined]
    cost = path_length(nodes[first], nodes[second]) + _TURNING * turned
    graph = coo_array((cost, (first, second)), shape=(len(nodes), len(nodes))).tocsr()
    length, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(length[1]):
        return None
    order = [1]
    while order[-1] != 0:
        order.append(int(before[order[-1]]))
    return np.array(order[::-1])


def _neighbours(places: Array) -> IntArray:
    """Pairs (m, 2) of nodes that are at most a step apart along each axis; places (n, D)."""
    if len(places) < 3:
        return np.zeros((0, 2), np.int64)
    size = places.shape[1]
    whole = np.round(places[2:] - places[2:].min(axis=0)).astype(int)
    cells = {tuple(cell): k + 2 for k, cell in enumerate(whole.tolist())}
    shifts = [s for s in product((-1, 0, 1), repeat=size) if s > (0,) * size]
    pairs = []
    for cell, k in cells.items():
        for shift in shifts:
            other = cells.get(tuple(map(add, cell, shift)))
            if other is not None:
                pairs.append((k, other))
    for end in (0, 1):
        near = np.flatnonzero(np.abs(places - places[end]).max(axis=1) <= 1 + 1e-9)
        pairs += [(end, int(k)) for k in near if k != end]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _pieces(way: Array, inside: BoolArray, blocks: Array) -> list[tuple[Array, Array]]:
    """A way cut where it goes from one block to the next; each block is kept as long as can be."""
    pieces, begin = [], 0
    while begin < len(way) - 1:
        lasts = [_run(inside[begin:, block]) for block in range(len(blocks))]
        block = int(np.argmax(lasts))
        end = begin + lasts[block] - 1
        if end <= begin:
            return []  # neighbours are in a common block, so this cannot be
        pieces.append((way[begin : end + 1], blocks[block]))
        begin = end
    return pieces


def _run(holds: BoolArray) -> int:
    """How many of the first are true without a gap."""
    return int(len(holds) if holds.all() else np.argmin(holds))
