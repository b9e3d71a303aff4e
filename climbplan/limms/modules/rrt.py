"""Path planning around obstacles by bidirectional random trees (RRT-Connect).

See Kuffner and LaValle, RRT-Connect, ICRA 2000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray

IsFree = Callable[[Array], BoolArray]  # (n, d) -> (n,)


@dataclass(frozen=True)
class _FreeSpace:
    """Free points of a space, whose lines are tested at points at most `step` apart."""

    is_free: IsFree
    step: float  # in the largest coordinate

    def is_clear(self, first: Array, last: Array) -> bool:
        """Return whether all points on the line are free."""
        return bool(self.is_free(self._sample_line(first, last)).all())

    def extend(self, first: Array, last: Array) -> Array:
        """Return the furthest free point on the line from first to last."""
        points = self._sample_line(first, last)[1:]
        blocked = np.flatnonzero(~self.is_free(points))
        num_free = blocked[0] if len(blocked) else len(points)
        return points[num_free - 1] if num_free > 0 else first

    def _sample_line(self, first: Array, last: Array) -> Array:
        num_steps = max(int(np.ceil(np.abs(last - first).max() / self.step)), 1)
        fractions = np.linspace(0, 1, num_steps + 1)[:, None]
        return first + fractions * (last - first)


def plan_path(
    start: Array,
    goal: Array,
    lower: Array,
    upper: Array,
    *,
    is_free: IsFree,
    step: float,
    rng: np.random.Generator,
    max_iterations: int = 400,
) -> Array | None:
    """Return corners (n, d) of a free polyline from start to goal, shortened; None without one.

    Args:
        start: Start (d,).
        goal: Goal (d,).
        lower: Lower bounds of samples (d,).
        upper: Upper bounds of samples (d,).
        is_free: Returns which points (n, d) are free.
        step: Largest distance of neighbouring points that are tested, in the largest coordinate.
        rng: Random generator.
        max_iterations: Largest number of samples.
    """
    space = _FreeSpace(is_free, step)
    if not is_free(np.array([start, goal])).all():
        return None
    if space.is_clear(start, goal):
        return np.array([start, goal])
    trees: list[tuple[list[Array], list[int]]] = [([start], [-1]), ([goal], [-1])]
    for iteration in range(max_iterations):
        tree, other_tree = trees[iteration % 2], trees[1 - iteration % 2]
        target = rng.uniform(lower, upper)
        nearest = _find_nearest(tree[0], target)
        new = space.extend(tree[0][nearest], target)
        if np.abs(new - tree[0][nearest]).max() < 1e-9:
            continue
        tree[0].append(new)
        tree[1].append(nearest)
        other_nearest = _find_nearest(other_tree[0], new)
        reached_point = space.extend(other_tree[0][other_nearest], new)
        if np.abs(reached_point - other_tree[0][other_nearest]).max() > 1e-9:
            other_tree[0].append(reached_point)
            other_tree[1].append(other_nearest)
            other_nearest = len(other_tree[0]) - 1
        if np.abs(other_tree[0][other_nearest] - new).max() < 1e-9:
            path_back = _trace_path(tree, len(tree[0]) - 1)
            other_path = _trace_path(other_tree, other_nearest)
            path = (
                path_back[::-1] + other_path if iteration % 2 == 0 else other_path[::-1] + path_back
            )
            return _shorten(np.array(path), space.is_clear, rng)
    return None


def _find_nearest(points: list[Array], target: Array) -> int:
    """Return the index of the point nearest to a target, in the largest coordinate."""
    return int(np.argmin(np.abs(np.array(points) - target).max(axis=1)))


def _trace_path(tree: tuple[list[Array], list[int]], node: int) -> list[Array]:
    """Return the points from a node to the root of its tree."""
    path = []
    while node >= 0:
        path.append(tree[0][node])
        node = tree[1][node]
    return path


def _shorten(
    path: Array, is_clear: Callable[[Array, Array], bool], rng: np.random.Generator
) -> Array:
    """Return the path without duplicates, shortened by random shortcuts."""
    is_new = np.any(np.abs(np.diff(path, axis=0)) > 1e-12, axis=1)
    path = path[np.concatenate([[True], is_new])]
    for _ in range(60):
        if len(path) <= 2:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False))
        if j > i + 1 and is_clear(path[i], path[j]):
            path = np.vstack([path[: i + 1], path[j:]])
    return path
