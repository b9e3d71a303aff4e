"""The exact check of a placement in the meaning `contact`, from poses and states alone.

Books stand on the ground between the walls and below the clear height without overlap, in the
stored order; each is flat, upright or leaning; a leaning book tilts far enough for gravity to hold
it (eq. (8.9), K2) and touches the stored neighbour or the wall on its side (K1, L1) within the
contact gap, the book inserted last being no support.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.checks import NamedResidual, PlacementCheck, select_worst
from climbplan.bookshelf.scene.rectangles import (
    ANGLE_LIMIT,
    compute_distance,
    compute_half_extents,
    compute_separation,
    find_ground_contact,
)
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf

LENGTH_LIMIT = 1e-5  # [m]

_TARGET = {
    BookState.FLAT_LEFT: math.pi / 2,
    BookState.UPRIGHT: 0.0,
    BookState.FLAT_RIGHT: -math.pi / 2,
}
_LEAN_SIGN = {BookState.LEAN_LEFT: 1.0, BookState.LEAN_RIGHT: -1.0}


def check_contact(
    scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf, length_limit: float = LENGTH_LIMIT
) -> PlacementCheck:
    """Check placements of S scenes with n stored books.

    Args:
        scenes: the stored books before the insertion and the inserted books.
        pose: (S, n + 1, 3) x, y [m], angle [rad], the inserted book last.
        state: (S, n + 1) of `BookState`.
        shelf: walls, clear height and contact gaps.
        length_limit: largest violation of a constraint on lengths [m].

    Returns:
        Residuals in mm and rad. A pose that is not finite fails every constraint it enters.
    """
    size, books = scenes.sizes, name_books(scenes.count)
    reach = compute_half_extents(pose[..., 2], size)
    limit = 1e3 * length_limit
    x, y = pose[..., 0], pose[..., 1]
    beyond = np.maximum(x + reach[..., 0] - shelf.right, shelf.left - x + reach[..., 0])
    off_ground = np.abs(y - reach[..., 1])
    too_high = y + reach[..., 1] - shelf.height
    return PlacementCheck(
        "contact",
        (
            _measure_overlap(pose, size, limit),
            select_worst("book.wall", "mm", limit, 1e3 * beyond, books),
            select_worst("book.ground", "mm", limit, 1e3 * off_ground, books),
            select_worst("book.clear_height", "mm", limit, 1e3 * too_high, books),
            select_worst(
                "book.state", "rad", ANGLE_LIMIT, _compute_state_error(pose[..., 2], state), books
            ),
            select_worst(
                "book.stability",
                "rad",
                ANGLE_LIMIT,
                _compute_lean_shortfall(pose, size, state, shelf),
                books,
            ),
            select_worst(
                "book.support",
                "mm",
                limit,
                1e3 * _measure_support_gaps(scenes, pose, state, shelf),
                books,
            ),
            _measure_order_violation(pose, size, limit),
        ),
    )


def name_books(count: int) -> list[str]:
    """Return the names of n stored books and of the inserted one."""
    return [f"book {k}" for k in range(count)] + ["the inserted book"]


def _measure_overlap(pose: Array, size: Array, limit: float) -> NamedResidual:
    names = name_books(pose.shape[1] - 1)
    pairs = list(itertools.combinations(range(pose.shape[1]), 2))
    i, j = (np.array(side) for side in zip(*pairs, strict=True))
    depth = -compute_separation(pose[:, i], size[:, i], pose[:, j], size[:, j])
    places = [f"{names[a]} and {names[b]}" for a, b in pairs]
    return select_worst("book.overlap", "mm", limit, 1e3 * depth, places)


def _compute_state_error(angle: Array, state: IntArray) -> Array:
    """Return how far angles (S, n + 1) are from those of the states [rad]."""
    off = np.full(angle.shape, np.inf)
    for value, target in _TARGET.items():
        off = np.where(state == value, np.abs(angle - target), off)
    for value, sign in _LEAN_SIGN.items():
        outside = np.maximum(-sign * angle, sign * angle - math.pi / 2)
        off = np.where(state == value, outside, off)
    leaning = (state[:, -1] == BookState.LEAN_LEFT) | (state[:, -1] == BookState.LEAN_RIGHT)
    off[leaning, -1] = np.inf  # the inserted book is let go of upright or flat
    return off


def _compute_lean_shortfall(pose: Array, size: Array, state: IntArray, shelf: Shelf) -> Array:
    """Return the tilt that leaning books lack for stability (S, n + 1) [rad]."""
    leaning = (state == BookState.LEAN_LEFT) | (state == BookState.LEAN_RIGHT)
    short: Array = np.where(leaning, shelf.min_lean_angle(size) - np.abs(pose[..., 2]), 0.0)
    return short


def _measure_support_gaps(scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf) -> Array:
    """Return how far leaning books are from their support beyond the contact gap (S, n + 1) [m]."""
    size, n = scenes.sizes, scenes.count
    gap = np.zeros(state.shape)
    for k in range(n):
        reach = compute_half_extents(pose[:, k, 2], size[:, k])[:, 0]
        for side, step in ((BookState.LEAN_LEFT, -1), (BookState.LEAN_RIGHT, 1)):
            neighbour = k + step
            if 0 <= neighbour < n:
                apart = compute_distance(
                    pose[:, k], size[:, k], pose[:, neighbour], size[:, neighbour]
                )
                beyond = apart - shelf.book_gap
            elif step < 0:
                beyond = pose[:, k, 0] - reach - shelf.left - shelf.wall_gap
            else:
                beyond = shelf.right - pose[:, k, 0] - reach - shelf.wall_gap
            gap[:, k] = np.where(state[:, k] == side, beyond, gap[:, k])
    return gap


def _measure_order_violation(pose: Array, size: Array, limit: float) -> NamedResidual:
    """Measure how far centres or feet of the stored books are out of order."""
    x, feet = pose[:, :-1, 0], find_ground_contact(pose, size)[:, :-1]
    back = np.maximum(x[:, :-1] - x[:, 1:], feet[:, :-1] - feet[:, 1:])
    places = [f"books {k} and {k + 1}" for k in range(back.shape[1])]
    return select_worst("book.order", "mm", limit, 1e3 * back, places)
