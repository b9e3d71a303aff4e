"""Ways that a toe may take from one contact to the next: straight, over a point, drawn aside."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array

_SPACING = 0.01  # [m] between the points at which a way is checked
_LIFTS = (1.0, 1.6, 2.4)  # factors on the spec's lift
_DETOURS = (0.06, 0.12, 0.18, 0.26)  # [m] how far aside the via points lie
_DIRECTIONS = np.array(
    [d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], float
)  # towards faces, edges and corners of a cube
_UNIT_DIRECTIONS = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1)[:, None]


def compute_hover_points(contacts: Array, normals: Array, height: float) -> Array:
    """Compute points (2, 3) at a height above the old and the new contact (2, 3) [m]."""
    return np.asarray(contacts + height * normals)


def join_path(ends: Array, path: Array) -> Array:
    """Join a path (P, 3) with two end points to a path (P + 2, 3)."""
    return np.concatenate([ends[:1], path, ends[1:]])


def generate_paths(contacts: Array, normals: Array, lift: float) -> Iterator[Array]:
    """Generate paths (P, 3) between two contacts (2, 3): straight first, then by detour length."""
    for factor in _LIFTS:
        ends = compute_hover_points(contacts, normals, factor * lift)
        yield ends
        middle = ends.mean(axis=0)
        for detour in _DETOURS:
            vias = middle + detour * _UNIT_DIRECTIONS
            length = np.linalg.norm(vias[:, None] - ends, axis=2).sum(axis=1)
            for via in vias[np.argsort(length, kind="stable")]:
                yield np.stack([ends[0], via, ends[1]])
    ends = compute_hover_points(contacts, normals, lift)
    for detour in _DETOURS:
        for offset in detour * _UNIT_DIRECTIONS:
            yield np.stack([ends[0], ends[0] + offset, ends[1] + offset, ends[1]])


def sample_path(path: Array) -> Array:
    """Sample points (S, 3) along a polyline, including its corners."""
    pieces = [path[:1]]
    for start, end in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _SPACING)))
        pieces.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(pieces)


def merge_paths(paths: list[Array]) -> Array:
    """Merge paths of simultaneous swings to arrays (P, limbs, 3) with the points of the longest.

    Each keeps its corners; points are inserted at the middle of its longest segments.
    """
    count = max(len(path) for path in paths)
    merged = []
    for original in paths:
        path = original
        while len(path) < count:
            piece = int(np.argmax(np.linalg.norm(np.diff(path, axis=0), axis=1)))
            middle = path[piece : piece + 2].mean(axis=0)
            path = np.insert(path, piece + 1, middle, axis=0)
        merged.append(path)
    return np.stack(merged, axis=1)


def compute_path_fractions(count: int) -> Array:
    """Compute the fractions (P,) of a sole's rotation at the points of a path."""
    return np.linspace(0.0, 1.0, count) if count > 1 else np.ones(1)


def sample_fractions(path: Array) -> Array:
    """Sample these fractions (S,) at the points of `sample_path`."""
    fractions, pieces_found = compute_path_fractions(len(path)), [np.zeros(1)]
    for k, (start, end) in enumerate(itertools.pairwise(path)):
        pieces = len(sample_path(np.stack([start, end])))
        pieces_found.append(np.linspace(fractions[k], fractions[k + 1], pieces)[1:])
    return np.concatenate(pieces_found)
