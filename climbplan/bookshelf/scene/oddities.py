"""Stored scenes that cannot stand as they are: legal, as they only say from where books are moved.

The stored scene is the reference of the movement cost and nothing else, so that scenes which
overlap, float or lie outside the shelf are solved like any other; a person should know of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.scene.rectangles import compute_half_extents, compute_separation
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf

DEPTH = 5e-4  # [m] of overlap, below the ground or in a wall: rounding and soft contacts stay below


def find_oddities(scenes: Scenes, shelf: Shelf) -> tuple[str, ...]:
    """Find physical inconsistencies of scenes: one line for each kind, with its worst place."""
    return tuple(_find_oddity_lines(scenes, shelf))


def _find_oddity_lines(scenes: Scenes, shelf: Shelf) -> Iterator[str]:
    pose, size = scenes.pose, scenes.size
    reach = compute_half_extents(pose[..., 2], size)
    x, y = pose[..., 0], pose[..., 1]
    books = [f"book {k}" for k in range(scenes.count)]
    if scenes.count > 1:
        pairs = list(itertools.combinations(range(scenes.count), 2))
        i, j = (np.array(side) for side in zip(*pairs, strict=True))
        depth = -compute_separation(pose[:, i], size[:, i], pose[:, j], size[:, j])
        names = [f"books {a} and {b}" for a, b in pairs]
        yield from _describe_worst(depth, DEPTH, names, "{} overlap by {} before the insertion")
        following = [f"book {k}" for k in range(1, scenes.count)]
        back = x[:, :-1] - x[:, 1:]
        yield from _describe_worst(
            back, DEPTH, following, "{} stands {} left of the book listed before it"
        )
    yield from _describe_worst(
        y - reach[..., 1], shelf.book_gap, books, "{} floats {} above the ground"
    )
    yield from _describe_worst(reach[..., 1] - y, DEPTH, books, "{} reaches {} below the ground")
    beyond = np.maximum(x + reach[..., 0] - shelf.right, shelf.left - x + reach[..., 0])
    yield from _describe_worst(beyond, DEPTH, books, "{} reaches {} into or beyond a wall")


def _describe_worst(excess: Array, limit: float, names: list[str], template: str) -> Iterator[str]:
    """Describe the worst excess above a limit, if there is one.

    Args:
        excess: (S, K) by scene and place [m].
        limit: largest excess that is no oddity [m].
        names: K names of the places.
        template: format string with fields for a name and a length.
    """
    is_odd = (excess > limit).any(axis=1)
    if not is_odd.any():
        return
    scene, place = np.unravel_index(int(np.argmax(excess)), excess.shape)
    line = template.format(names[place], f"{1e3 * excess[scene, place]:.1f} mm")
    if len(excess) > 1:
        context = (
            f"the worst of {is_odd.sum()} such scenes"
            if is_odd.sum() > 1
            else "the only such scene"
        )
        line = f"scene {scene}: {line} ({context})"
    elif (more := int((excess > limit).sum()) - 1) > 0:
        line += f" (and {more} more)"
    yield line
