"""The exact check of a placement in the meaning `contact`, from poses and states alone.

Books stand on the ground between the walls and below the clear height without overlap, in the
stored order; each is flat, upright or leaning; a leaning book tilts far enough for gravity to hold
it (eq. (8.9), K2) and touches the stored neighbour or the wall on its side (K1, L1) within the
contact gap, the book inserted last being no support.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.checks import NamedResidual, PlacementCheck, worst_of
from climbplan.bookshelf.scene.rectangles import (
    ANGLE_LIMIT,
    distance,
    ground_contact,
    half_extents,
    separation,
)
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, State

LENGTH_LIMIT = 1e-5  # [m]

_TARGET = {State.FLAT_LEFT: math.pi / 2, State.UPRIGHT: 0.0, State.FLAT_RIGHT: -math.pi / 2}
_LEAN_SIGN = {State.LEAN_LEFT: 1.0, State.LEAN_RIGHT: -1.0}


def check_contact(
    scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf, length_limit: float = LENGTH_LIMIT
) -> PlacementCheck:
    """Check placements of S scenes with n stored books.

    pose: (S, n + 1, 3) x, y [m], angle [rad], the inserted book last. state: (S, n + 1) of `State`.
    length_limit: largest overlap, gap beyond the contact gap, and so on [m]. Residuals are in mm
    and rad. A pose that is not finite fails every constraint it bears on.
    """
    size, books = scenes.sizes, book_names(scenes.count)
    reach = half_extents(pose[..., 2], size)
    limit = 1e3 * length_limit
    x, y = pose[..., 0], pose[..., 1]
    beyond = np.maximum(x + reach[..., 0] - shelf.right, shelf.left - x + reach[..., 0])
    off_ground = np.abs(y - reach[..., 1])
    too_high = y + reach[..., 1] - shelf.height
    return PlacementCheck(
        "contact",
        (
            _overlap(pose, size, limit),
            worst_of("book.wall", "mm", limit, 1e3 * beyond, books),
            worst_of("book.ground", "mm", limit, 1e3 * off_ground, books),
            worst_of("book.clear_height", "mm", limit, 1e3 * too_high, books),
            worst_of("book.state", "rad", ANGLE_LIMIT, _off_state(pose[..., 2], state), books),
            worst_of(
                "book.stability", "rad", ANGLE_LIMIT, _unstable(pose, size, state, shelf), books
            ),
            worst_of("book.support", "mm", limit, 1e3 * _gaps(scenes, pose, state, shelf), books),
            _order(pose, size, limit),
        ),
    )


def book_names(count: int) -> list[str]:
    """Names of n stored books and the inserted one."""
    return [f"book {k}" for k in range(count)] + ["the inserted book"]


def _overlap(pose: Array, size: Array, limit: float) -> NamedResidual:
    names = book_names(pose.shape[1] - 1)
    pairs = list(itertools.combinations(range(pose.shape[1]), 2))
    i, j = (np.array(side) for side in zip(*pairs, strict=True))
    depth = -separation(pose[:, i], size[:, i], pose[:, j], size[:, j])
    places = [f"{names[a]} and {names[b]}" for a, b in pairs]
    return worst_of("book.overlap", "mm", limit, 1e3 * depth, places)


def _off_state(angle: Array, state: IntArray) -> Array:
    """How far angles (S, n + 1) are from those of the states [rad]."""
    off = np.full(angle.shape, np.inf)
    for value, target in _TARGET.items():
        off = np.where(state == value, np.abs(angle - target), off)
    for value, sign in _LEAN_SIGN.items():
        outside = np.maximum(-sign * angle, sign * angle - math.pi / 2)
        off = np.where(state == value, outside, off)
    leaning = (state[:, -1] == State.LEAN_LEFT) | (state[:, -1] == State.LEAN_RIGHT)
    off[leaning, -1] = np.inf  # the inserted book is let go of upright or flat
    return off


def _unstable(pose: Array, size: Array, state: IntArray, shelf: Shelf) -> Array:
    """How much a leaning book tilts too little [rad]."""
    leaning = (state == State.LEAN_LEFT) | (state == State.LEAN_RIGHT)
    short: Array = np.where(leaning, shelf.least_lean(size) - np.abs(pose[..., 2]), 0.0)
    return short


def _gaps(scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf) -> Array:
    """Distance of leaning books from their support beyond the contact gap (S, n + 1) [m]."""
    size, n = scenes.sizes, scenes.count
    gap = np.zeros(state.shape)
    for k in range(n):
        reach = half_extents(pose[:, k, 2], size[:, k])[:, 0]
        for side, step in ((State.LEAN_LEFT, -1), (State.LEAN_RIGHT, 1)):
            other = k + step
            if 0 <= other < n:
                apart = distance(pose[:, k], size[:, k], pose[:, other], size[:, other])
                beyond = apart - shelf.book_gap
            elif step < 0:
                beyond = pose[:, k, 0] - reach - shelf.left - shelf.wall_gap
            else:
                beyond = shelf.right - pose[:, k, 0] - reach - shelf.wall_gap
            gap[:, k] = np.where(state[:, k] == side, beyond, gap[:, k])
    return gap


def _order(pose: Array, size: Array, limit: float) -> NamedResidual:
    """Centres and feet of the stored books from left to right."""
    x, feet = pose[:, :-1, 0], ground_contact(pose, size)[:, :-1]
    back = np.maximum(x[:, :-1] - x[:, 1:], feet[:, :-1] - feet[:, 1:])
    places = [f"books {k} and {k + 1}" for k in range(back.shape[1])]
    return worst_of("book.order", "mm", limit, 1e3 * back, places)
