"""Scenes as seen in a mirror: left and right swapped, solutions with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.shelf_scene import Scene, State

_FLIP = np.array([-1.0, 1.0, -1.0])  # x, y, angle
_ACROSS = np.array([1.0, 0.0, 0.0])
_SWAPPED = np.zeros(len(State), np.int64)
for _one, _other in (
    (State.FLAT_LEFT, State.FLAT_RIGHT),
    (State.LEAN_LEFT, State.LEAN_RIGHT),
    (State.UPRIGHT, State.UPRIGHT),
):
    _SWAPPED[_one], _SWAPPED[_other] = _other, _one


@dataclass(frozen=True)
class Solved:
    """A scene and a placement for it."""

    scene: Scene
    placement: Placement


def mirrored(solved: Solved, middle: float = 0.0) -> Solved:
    """The same on a shelf that is mirrored about x = middle [m]; books are again counted from the
    left.

    On a shelf that is its own mirror image costs and checks stay what they were.
    """
    scene, placement = solved.scene, solved.placement
    n = scene.count
    back = np.arange(n)[::-1]
    books, shift = np.append(back, n), 2 * middle * _ACROSS
    return Solved(
        Scene(scene.pose[back] * _FLIP + shift, scene.size[back], scene.inserted),
        Placement(
            placement.pose[books] * _FLIP + shift,
            _SWAPPED[placement.state[books]],
            n - placement.slot,
        ),
    )
