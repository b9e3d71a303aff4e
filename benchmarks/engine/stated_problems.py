"""Published kinds of problems, stated in CVXPY with data of our own.

Footsteps are chosen as SL1M states it (Tonneau et al. 2020): the contact of each step lies on one
of several convex surfaces, within a polytope about the feet that stand. Graphs of convex sets have
perspectives of lengths on their edges (Marcucci et al. 2024), as the examples of GCSOPT.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cvxpy
import numpy as np

from climbplan.arrays import Array

cp: Any = cvxpy  # whose functions have no types
_MAX_SLOPE = 0.3  # of stones, rise over run


def _place_foot(foot: Any, chosen: Any, corners: Array, planes: Array) -> list[Any]:
    """Return the rows that place a foot on the chosen one of S surfaces, by convex hulls.

    Args:
        foot: Position (3,) [m].
        chosen: Binaries (S,), of which one is 1.
        corners: (S, 2, 2) least and largest x and y of each surface [m].
        planes: (S, 3) height a x + b y + c of each surface [m].
    """
    on_surface = cp.Variable((len(corners), 2))
    height = cp.sum(cp.multiply(planes[:, :2], on_surface)) + planes[:, 2] @ chosen
    sides = cp.vstack([chosen, chosen]).T
    return [
        cp.sum(chosen) == 1,
        foot[:2] == cp.sum(on_surface, axis=0),
        foot[2] == height,
        on_surface >= cp.multiply(corners[:, 0], sides),
        on_surface <= cp.multiply(corners[:, 1], sides),
    ]


def state_rubble(rng: np.random.Generator, steps: int = 10) -> Any:
    """A biped over tilted stones in two rows: each step may be on any stone of its side."""
    columns = steps // 2 + 2
    feet: list[Any] = [np.array([0.0, 0.1, 0.0]), np.array([0.0, -0.1, 0.0])]
    rows: list[Any] = []
    cost, stones = 0.0, []
    for side in (1.0, -1.0):
        center = np.column_stack(
            [0.3 * np.arange(columns) + rng.uniform(-0.05, 0.05, columns), np.full(columns, 0.0)]
        )
        center[:, 1] = side * rng.uniform(0.05, 0.2, columns)
        half = rng.uniform(0.06, 0.12, (columns, 2))
        slope = rng.uniform(-_MAX_SLOPE, _MAX_SLOPE, (columns, 2))
        height = rng.uniform(-0.08, 0.08, columns) - np.sum(slope * center, axis=1)
        corners = np.stack([center - half, center + half], axis=1)
        stones.append((corners, np.column_stack([slope, height])))
    for k in range(steps):
        foot, chosen = cp.Variable(3), cp.Variable(columns, boolean=True)
        side = 1.0 if k % 2 == 0 else -1.0
        rows += _place_foot(foot, chosen, *stones[k % 2])
        stride = foot - feet[-1]
        reach = np.array([[-0.1, 0.24 * side - 0.16, -0.15], [0.45, 0.24 * side + 0.16, 0.15]])
        rows += [stride >= reach[0], stride <= reach[1]]
        cost += cp.sum_squares(stride - np.array([0.15, 0.2 * side, 0.0]))
        feet.append(foot)
    goal = 0.3 * (columns - 2)
    return cp.Problem(cp.Minimize(cost + 5.0 * cp.square(feet[-1][0] - goal)), rows)


def state_stairs(rng: np.random.Generator, steps: int = 12) -> Any:
    """A quadruped that crawls up stairs of unequal treads: one foot a step, on any tread."""
    treads = 6
    ends = np.concatenate([[-0.8], np.cumsum(rng.uniform(0.25, 0.35, treads))])
    corners = np.array([[[a + 0.02, -0.6], [b - 0.02, 0.6]] for a, b in pairwise(ends)])
    rise = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.17, treads - 1))])
    planes = np.column_stack([np.zeros((treads, 2)), rise])
    stance = np.array([[0.0, 0.2], [0.0, -0.2], [-0.6, 0.2], [-0.6, -0.2]])  # from the front, left
    feet: list[Any] = [np.append(xy, 0.0) for xy in stance]
    rows, cost = [], 0.0
    for k in range(steps):
        leg = (0, 3, 1, 2)[k % 4]
        foot, chosen = cp.Variable(3), cp.Variable(treads, boolean=True)
        rows += _place_foot(foot, chosen, corners, planes)
        for other in set(range(4)) - {leg}:
            apart = foot - feet[other]
            nominal = np.append(stance[leg] - stance[other], 0.0)
            reach = np.array([0.35, 0.12, 0.35])
            rows += [apart >= nominal - reach, apart <= nominal + reach]
            cost += cp.sum_squares(apart - nominal)
        feet[leg] = foot
    rise_goal = 0.2 * (steps // 4)
    return cp.Problem(cp.Minimize(cost + 3.0 * cp.square(feet[0][0] - rise_goal)), rows)


def _draw_boxes(rng: np.random.Generator, centers: Array, half: float) -> tuple[Array, Array]:
    """Return lower and upper corners (V, 2) of boxes of random sizes."""
    sizes = rng.uniform(0.3 * half, half, centers.shape)
    return centers - sizes, centers + sizes


class _Edges:
    """Variables of a graph's edges: whether they are used, and both ends, scaled by that."""

    def __init__(self, ends: list[tuple[int, int]], lower: Array, upper: Array) -> None:
        """Name edges by the vertices (tail, head) of boxes lower <= x <= upper (V, 2)."""
        tail, head = np.array(ends).T
        self.use = cp.Variable(len(ends), boolean=True)
        self.tail, self.head = cp.Variable((len(ends), 2)), cp.Variable((len(ends), 2))
        scale = cp.vstack([self.use, self.use]).T
        self.rows = [
            self.tail >= cp.multiply(lower[tail], scale),
            self.tail <= cp.multiply(upper[tail], scale),
            self.head >= cp.multiply(lower[head], scale),
            self.head <= cp.multiply(upper[head], scale),
        ]
        vertices = np.arange(len(lower))[:, None]
        self.leaves = (tail == vertices).astype(float)  # (V, E) edge leaves vertex
        self.enters = (head == vertices).astype(float)

    @property
    def length(self) -> Any:
        """The sum of the lengths of used edges."""
        return cp.sum(cp.norm(self.head - self.tail, 2, axis=1))


def state_shortest_path(rng: np.random.Generator, width: int = 6, height: int = 4) -> Any:
    """The shortest path through boxes on a grid, each crossed at most once."""
    grid = np.array([(x, y) for x in range(width) for y in range(height)], float)
    lower, upper = _draw_boxes(rng, grid + rng.uniform(-0.2, 0.2, grid.shape), 0.35)
    ends = [
        (a, b)
        for a, first in enumerate(grid)
        for b, second in enumerate(grid)
        if a != b and np.abs(first - second).sum() <= 1.0 + (second[0] > first[0])
    ]
    edges, last = _Edges(ends, lower, upper), len(grid) - 1
    balance, passed = np.zeros(len(grid)), edges.enters @ edges.use
    balance[0], balance[last] = 1.0, -1.0
    inner = slice(1, last)
    rows = [
        *edges.rows,
        edges.leaves @ edges.use - passed == balance,
        passed[0] == 0,
        passed <= 1,
        (edges.leaves @ edges.tail)[inner] == (edges.enters @ edges.head)[inner],
    ]
    toll = rng.uniform(0.0, 0.4, len(ends))
    return cp.Problem(cp.Minimize(edges.length + toll @ edges.use), rows)


def state_traveling_salesman(rng: np.random.Generator, count: int = 7) -> Any:
    """The shortest tour of boxes; orders of vertices exclude tours of some (Miller et al. 1960)."""
    lower, upper = _draw_boxes(rng, rng.uniform(0.0, 3.0, (count, 2)), 0.4)
    ends = [(a, b) for a in range(count) for b in range(count) if a != b]
    edges, order = _Edges(ends, lower, upper), cp.Variable(count)
    rows = [
        *edges.rows,
        edges.leaves @ edges.use == 1,
        edges.enters @ edges.use == 1,
        edges.leaves @ edges.tail == edges.enters @ edges.head,
        order >= 0,
        order <= count - 1,
    ]
    rows += [
        order[a] - order[b] + count * edges.use[e] <= count - 1
        for e, (a, b) in enumerate(ends)
        if a and b
    ]
    return cp.Problem(cp.Minimize(edges.length), rows)


def state_facilities(rng: np.random.Generator, count: int = 5, users: int = 9) -> Any:
    """Facilities at points of boxes, each at a price, and users at points of theirs."""
    lower, upper = _draw_boxes(rng, rng.uniform(0.0, 4.0, (count + users, 2)), 0.6)
    ends = [(i, count + j) for i in range(count) for j in range(users)]
    edges, is_open = _Edges(ends, lower, upper), cp.Variable(count, boolean=True)
    place, tail = cp.Variable((count, 2)), edges.leaves[:count].T
    unused = 1 - edges.use
    rest = tail @ place - edges.tail  # of the facility's place where the edge is not used
    scale = cp.vstack([unused, unused]).T
    rows = [
        *edges.rows,
        (edges.enters @ edges.use)[count:] == 1,
        edges.use <= tail @ is_open,
        rest >= cp.multiply(tail @ lower[:count], scale),
        rest <= cp.multiply(tail @ upper[:count], scale),
    ]
    return cp.Problem(cp.Minimize(edges.length + rng.uniform(0.5, 2.0, count) @ is_open), rows)


@dataclass(frozen=True)
class StatedProblems:
    """One kind of problem in one size."""

    name: str
    generate: Callable[..., Any]
    sizes: Mapping[str, int]
    fits_licence: bool  # of Gurobi without charge: 200 variables where anything is quadratic


STATED_PROBLEMS = (
    StatedProblems("steps on rubble, 8", state_rubble, {"steps": 8}, True),
    StatedProblems("steps on rubble, 10", state_rubble, {"steps": 10}, False),
    StatedProblems("steps on stairs, 6", state_stairs, {"steps": 6}, True),
    StatedProblems("steps on stairs, 12", state_stairs, {"steps": 12}, False),
    StatedProblems("GCS, path, 6 boxes", state_shortest_path, {"width": 3, "height": 2}, True),
    StatedProblems("GCS, path, 24 boxes", state_shortest_path, {"width": 6, "height": 4}, False),
    StatedProblems("GCS, tour, 5 boxes", state_traveling_salesman, {"count": 5}, True),
    StatedProblems("GCS, tour, 7 boxes", state_traveling_salesman, {"count": 7}, False),
    StatedProblems("GCS, facilities, 3", state_facilities, {"count": 3, "users": 6}, True),
    StatedProblems("GCS, facilities, 5", state_facilities, {"count": 5, "users": 9}, False),
)
