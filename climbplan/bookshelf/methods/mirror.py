"""Scenes as seen in a mirror: left and right swapped, solutions with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.shelf_scene import BookState, ShelfScene

_FLIP = np.array([-1.0, 1.0, -1.0])  # x, y, angle
_ACROSS = np.array([1.0, 0.0, 0.0])
_SWAPPED = np.zeros(len(BookState), np.int64)
for _state, _mirror_image in (
    (BookState.FLAT_LEFT, BookState.FLAT_RIGHT),
    (BookState.LEAN_LEFT, BookState.LEAN_RIGHT),
    (BookState.UPRIGHT, BookState.UPRIGHT),
):
    _SWAPPED[_state], _SWAPPED[_mirror_image] = _mirror_image, _state


@dataclass(frozen=True)
class SolvedScene:
    """A scene and a placement for it."""

    scene: ShelfScene
    placement: Placement


def mirror_scene(solved: SolvedScene, middle: float = 0.0) -> SolvedScene:
    """Mirror a solved scene about x = middle [m]; books are again counted from the left.

    On a shelf that is its own mirror image the cost and the checks are the same.
    """
    scene, placement = solved.scene, solved.placement
    n = scene.count
    back = np.arange(n)[::-1]
    books, shift = np.append(back, n), 2 * middle * _ACROSS
    return SolvedScene(
        ShelfScene(scene.pose[back] * _FLIP + shift, scene.size[back], scene.inserted),
        Placement(
            placement.pose[books] * _FLIP + shift,
            _SWAPPED[placement.state[books]],
            n - placement.slot,
        ),
    )
