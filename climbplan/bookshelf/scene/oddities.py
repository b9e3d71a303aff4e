"""Stored scenes that cannot stand as they are: legal, as they only say from where books are moved.

The stored scene is the reference of the movement cost and nothing else, so that scenes which
overlap, float or lie outside the shelf are solved like any other; a person should know of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.scene.rectangles import half_extents, separation
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf

DEPTH = 5e-4  # [m] of overlap, below the ground or in a wall: rounding and soft contacts stay below


def oddities(scenes: Scenes, shelf: Shelf) -> tuple[str, ...]:
    """One line for each way in which scenes are odd, with the worst place and its millimetres."""
    return tuple(_lines(scenes, shelf))


def _lines(scenes: Scenes, shelf: Shelf) -> Iterator[str]:
    pose, size = scenes.pose, scenes.size
    reach = half_extents(pose[..., 2], size)
    x, y = pose[..., 0], pose[..., 1]
    books = [f"book {k}" for k in range(scenes.count)]
    if scenes.count > 1:
        pairs = list(itertools.combinations(range(scenes.count), 2))
        i, j = (np.array(side) for side in zip(*pairs, strict=True))
        depth = -separation(pose[:, i], size[:, i], pose[:, j], size[:, j])
        names = [f"books {a} and {b}" for a, b in pairs]
        yield from _worst(depth, DEPTH, names, "{} overlap by {} before the insertion")
        following = [f"book {k}" for k in range(1, scenes.count)]
        back = x[:, :-1] - x[:, 1:]
        yield from _worst(back, DEPTH, following, "{} stands {} left of the book listed before it")
    yield from _worst(y - reach[..., 1], shelf.book_gap, books, "{} floats {} above the ground")
    yield from _worst(reach[..., 1] - y, DEPTH, books, "{} reaches {} below the ground")
    beyond = np.maximum(x + reach[..., 0] - shelf.right, shelf.left - x + reach[..., 0])
    yield from _worst(beyond, DEPTH, books, "{} reaches {} into or beyond a wall")


def _worst(excess: Array, limit: float, names: list[str], words: str) -> Iterator[str]:
    """excess: (S, K) [m] of K places named `names`; words: with room for a name and a length."""
    odd = (excess > limit).any(axis=1)
    if not odd.any():
        return
    scene, place = np.unravel_index(int(np.argmax(excess)), excess.shape)
    line = words.format(names[place], f"{1e3 * excess[scene, place]:.1f} mm")
    if len(excess) > 1:
        others = f"the worst of {odd.sum()} such scenes" if odd.sum() > 1 else "the only such scene"
        line = f"scene {scene}: {line} ({others})"
    elif (more := int((excess > limit).sum()) - 1) > 0:
        line += f" (and {more} more)"
    yield line
