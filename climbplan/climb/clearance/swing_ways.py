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
_ASIDE = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1)[:, None]


def hover(contacts: Array, normals: Array, height: float) -> Array:
    """Points (2, 3) over the contact left and the one reached, both (2, 3)."""
    return np.asarray(contacts + height * normals)


def joined(ends: Array, path: Array) -> Array:
    """A way (P + 2, 3) from the first of two points over a way to the other."""
    return np.concatenate([ends[:1], path, ends[1:]])


def candidates(contacts: Array, normals: Array, lift: float) -> Iterator[Array]:
    """Ways (P, 3) between two contacts (2, 3), the straight one first, the nearest aside next."""
    for factor in _LIFTS:
        ends = hover(contacts, normals, factor * lift)
        yield ends
        middle = ends.mean(axis=0)
        for aside in _DETOURS:
            vias = middle + aside * _ASIDE
            length = np.linalg.norm(vias[:, None] - ends, axis=2).sum(axis=1)
            for via in vias[np.argsort(length, kind="stable")]:
                yield np.stack([ends[0], via, ends[1]])
    ends = hover(contacts, normals, lift)
    for aside in _DETOURS:
        for away in aside * _ASIDE:
            yield np.stack([ends[0], ends[0] + away, ends[1] + away, ends[1]])


def sampled(path: Array) -> Array:
    """Points (S, 3) along a polyline, its corners among them."""
    pieces = [path[:1]]
    for start, end in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _SPACING)))
        pieces.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(pieces)


def together(paths: list[Array]) -> Array:
    """Paths (P, limbs, 3) of as many points as the longest, for limbs that swing at once.

    Each keeps its own corners; points are added in the middle of its longest pieces.
    """
    count = max(len(path) for path in paths)
    out = []
    for way in paths:
        path = way
        while len(path) < count:
            piece = int(np.argmax(np.linalg.norm(np.diff(path, axis=0), axis=1)))
            middle = path[piece : piece + 2].mean(axis=0)
            path = np.insert(path, piece + 1, middle, axis=0)
        out.append(path)
    return np.stack(out, axis=1)


def way_shares(count: int) -> Array:
    """(P,) how far soles have turned at the points of a way, from the old surface to the new."""
    return np.linspace(0.0, 1.0, count) if count > 1 else np.ones(1)


def sampled_shares(path: Array) -> Array:
    """(S,) the same at the points of `sampled`."""
    shares, found = way_shares(len(path)), [np.zeros(1)]
    for k, (start, end) in enumerate(itertools.pairwise(path)):
        pieces = len(sampled(np.stack([start, end])))
        found.append(np.linspace(shares[k], shares[k + 1], pieces)[1:])
    return np.concatenate(found)
