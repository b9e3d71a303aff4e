"""A way between two points round what is in the way: random trees grown from both ends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array, BoolArray

Free = Callable[[Array], BoolArray]  # (n, d) -> (n,)


def connect(
    start: Array,
    goal: Array,
    lower: Array,
    upper: Array,
    free: Free,
    step: float,
    rng: np.random.Generator,
    rounds: int = 400,
) -> Array | None:
    """Corners (n, d) of a free polyline from start to goal, shortened; None if none was found.

    free: says which points are free; step: largest distance between two points that are looked at,
    in the largest coordinate.
    """

    def clear(first: Array, last: Array) -> bool:
        count = max(int(np.ceil(np.abs(last - first).max() / step)), 1)
        share = np.linspace(0, 1, count + 1)[:, None]
        return bool(free(first + share * (last - first)).all())

    def advance(first: Array, last: Array) -> Array:
        """The furthest free point on the way from first to last."""
        count = max(int(np.ceil(np.abs(last - first).max() / step)), 1)
        share = np.linspace(0, 1, count + 1)[1:, None]
        points = first + share * (last - first)
        blocked = np.flatnonzero(~free(points))
        reached = blocked[0] if len(blocked) else count
        return points[reached - 1] if reached > 0 else first

    if not free(np.array([start, goal])).all():
        return None
    if clear(start, goal):
        return np.array([start, goal])
    trees: list[tuple[list[Array], list[int]]] = [([start], [-1]), ([goal], [-1])]
    for number in range(rounds):
        here, there = trees[number % 2], trees[1 - number % 2]
        target = rng.uniform(lower, upper)
        near = _nearest(here[0], target)
        new = advance(here[0][near], target)
        if np.abs(new - here[0][near]).max() < 1e-9:
            continue
        here[0].append(new)
        here[1].append(near)
        other = _nearest(there[0], new)
        met = advance(there[0][other], new)
        if np.abs(met - there[0][other]).max() > 1e-9:
            there[0].append(met)
            there[1].append(other)
            other = len(there[0]) - 1
        if np.abs(there[0][other] - new).max() < 1e-9:
            mine, theirs = _back(here, len(here[0]) - 1), _back(there, other)
            path = mine[::-1] + theirs if number % 2 == 0 else theirs[::-1] + mine
            return _shortened(np.array(path), clear, rng)
    return None


def _nearest(points: list[Array], target: Array) -> int:
    return int(np.argmin(np.abs(np.array(points) - target).max(axis=1)))


def _back(tree: tuple[list[Array], list[int]], node: int) -> list[Array]:
    path = []
    while node >= 0:
        path.append(tree[0][node])
        node = tree[1][node]
    return path


def _shortened(
    path: Array, clear: Callable[[Array, Array], bool], rng: np.random.Generator
) -> Array:
    keep = np.any(np.abs(np.diff(path, axis=0)) > 1e-12, axis=1)
    path = path[np.concatenate([[True], keep])]
    for _ in range(60):
        if len(path) <= 2:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False))
        if j > i + 1 and clear(path[i], path[j]):
            path = np.vstack([path[: i + 1], path[j:]])
    return path
