"""The published constraints as they stand, for comparison with published placements.

Lin et al. (arXiv 2110.00666; the source code that goes with it) state them with tolerances of
1.5 mm between points and 0.05 on sines, on a frame that is wider than where books come to rest.
Corners are numbered from the top right clockwise. A line separates two books; if one leans on the
other, the line passes the top right corner of the left book and the top left corner of the right
one, eqs. (8.9), (8.10). Books lean on adjacent stored books and on the end walls only.

The published program replaces rotations and lines by piecewise relaxations, so that its own
solutions break these constraints: the residuals say by how much.

Published methods, and equation numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.checker import name_books
from climbplan.bookshelf.check.checks import NamedResidual, PlacementCheck, select_worst
from climbplan.bookshelf.scene.rectangles import compute_corners, compute_separation
from climbplan.bookshelf.scene.shelf_scene import BookState, Scenes, Shelf

# What solvers leave on top of a tolerance that they use up [mm], on sines too
ROUNDING = 1e-4

_TOP_RIGHT, _BOTTOM_RIGHT, _BOTTOM_LEFT, _TOP_LEFT = range(4)


def infer_published_states(scenes: Scenes, pose: Array, shelf: Shelf) -> IntArray:
    """Infer states (S, n + 1) from published poses (S, n + 1, 3): those whose equations fit best.

    Among states within their tolerances, flat and upright ones come first. The inserted book does
    not lean.
    """
    rules, size = shelf.published, scenes.sizes
    scores = []
    for value in BookState:
        state = np.full(pose.shape[:2], int(value), np.int64)
        sine = np.maximum(_compute_sine_error(pose, state), 0) / max(rules.sine, 1e-9)
        ground = _compute_ground_error(pose, size, state) / max(rules.distance, 1e-9)
        score = np.maximum(sine, ground)
        scores.append(score if value in (BookState.LEAN_LEFT, BookState.LEAN_RIGHT) else score - 1)
    return np.argmin(scores, axis=0).astype(np.int64)


def check_published(scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf) -> PlacementCheck:
    """Check placements of S scenes: pose (S, n + 1, 3) [m, rad], state (S, n + 1).

    Residuals in mm, of angles as sines; limits are the published tolerances and a
    rounding of 1e-4.
    """
    rules, size = shelf.published, scenes.sizes
    books, limit = name_books(scenes.count), 1e3 * rules.distance + ROUNDING
    sine = rules.sine + ROUNDING
    vertex = compute_corners(pose, size)
    inside = np.maximum(
        np.abs(vertex[..., 0]).max(axis=-1) - rules.half_width,
        np.maximum(vertex[..., 1].max(axis=-1) - rules.height, -vertex[..., 1].min(axis=-1)),
    )
    support, stability = _measure_lean_support(scenes, pose, state, vertex, shelf)
    return PlacementCheck(
        "published",
        (
            select_worst("book.inside", "mm", limit, 1e3 * inside, books),
            select_worst("book.rotation", "", sine, -np.cos(pose[..., 2]), books),
            _check_separation(pose, size, limit),
            select_worst("book.state", "", sine, _compute_sine_error(pose, state), books),
            select_worst(
                "book.ground", "mm", limit, 1e3 * _compute_ground_error(pose, size, state), books
            ),
            select_worst("book.support", "mm", limit, 1e3 * support, books),
            select_worst("book.stability", "mm", limit, 1e3 * stability, books),
        ),
    )


def _check_separation(pose: Array, size: Array, limit: float) -> NamedResidual:
    """Check eq. (8.5): a line separates the corners of each two books."""
    names = name_books(pose.shape[1] - 1)
    pairs = list(itertools.combinations(range(pose.shape[1]), 2))
    i, j = (np.array(side) for side in zip(*pairs, strict=True))
    # The best line halves the overlap: each side is then off by half the depth.
    depth = -compute_separation(pose[:, i], size[:, i], pose[:, j], size[:, j]) / 2
    places = [f"{names[a]} and {names[b]}" for a, b in pairs]
    return select_worst("book.separation", "mm", limit, 1e3 * depth, places)


def _compute_sine_error(pose: Array, state: IntArray) -> Array:
    """Return the violation of eqs. (8.6) to (8.10) on R(2, 1), angle > 0 to the left."""
    sine = np.sin(pose[..., 2])
    off = np.abs(sine)
    off = np.where(state == BookState.FLAT_LEFT, 1 - sine, off)
    off = np.where(state == BookState.FLAT_RIGHT, 1 + sine, off)
    off = np.where(state == BookState.LEAN_LEFT, -sine, off)
    off = np.where(state == BookState.LEAN_RIGHT, sine, off)
    leaning = (state[:, -1] == BookState.LEAN_LEFT) | (state[:, -1] == BookState.LEAN_RIGHT)
    off[leaning, -1] = np.inf
    return off


def _compute_ground_error(pose: Array, size: Array, state: IntArray) -> Array:
    """Return the violation of eqs. (8.6) to (8.8) on the centre, (8.9), (8.10) on the foot [m]."""
    vertex = compute_corners(pose, size)
    off = np.abs(pose[..., 1] - size[..., 1] / 2)
    off = np.where(state == BookState.UPRIGHT, np.abs(pose[..., 1] - size[..., 0] / 2), off)
    off = np.where(state == BookState.LEAN_LEFT, np.abs(vertex[..., _BOTTOM_LEFT, 1]), off)
    return np.where(state == BookState.LEAN_RIGHT, np.abs(vertex[..., _BOTTOM_RIGHT, 1]), off)


def _measure_lean_support(
    scenes: Scenes, pose: Array, state: IntArray, vertex: Array, shelf: Shelf
) -> tuple[Array, Array]:
    """Measure eqs. (8.9), (8.10): contact and stability of leaning books, (S, n + 1) each [m]."""
    n, rules = scenes.count, shelf.published
    support, stability = np.zeros(state.shape), np.zeros(state.shape)
    x = pose[..., 0]
    for k in range(n):
        left, right = state[:, k] == BookState.LEAN_LEFT, state[:, k] == BookState.LEAN_RIGHT
        if k > 0:
            touch, neighbour_x = (
                fit_corner_line(vertex[:, k - 1], vertex[:, k]).tolerance,
                x[:, k - 1],
            )
        else:
            # On top of the tolerance that every constraint has.
            touch = vertex[:, k, _TOP_LEFT, 0] + rules.half_width - rules.left_wall
            neighbour_x = np.full(len(x), -rules.half_width)
        support[:, k] = np.where(left, touch, support[:, k])
        between = np.maximum(neighbour_x - x[:, k], x[:, k] - vertex[:, k, _BOTTOM_LEFT, 0])
        stability[:, k] = np.where(left, between, stability[:, k])
        if k < n - 1:
            touch, neighbour_x = (
                fit_corner_line(vertex[:, k], vertex[:, k + 1]).tolerance,
                x[:, k + 1],
            )
        else:
            touch = rules.half_width - vertex[:, k, _TOP_RIGHT, 0]
            neighbour_x = np.full(len(x), rules.half_width)
        support[:, k] = np.where(right, touch, support[:, k])
        between = np.maximum(x[:, k] - neighbour_x, vertex[:, k, _BOTTOM_RIGHT, 0] - x[:, k])
        stability[:, k] = np.where(right, between, stability[:, k])
    return support, stability


@dataclass(frozen=True)
class CornerLine:
    """Lines a . p = b between pairs of books that pass their upper corners."""

    normal: Array  # (S, 2) unit, from the left to the right book
    offset: Array  # (S,)
    tolerance: Array  # (S,) by which separation and passing are off at most


def fit_corner_line(left: Array, right: Array) -> CornerLine:
    """Fit the line that best separates two books and passes their upper corners.

    The books are given by corners (S, 4, 2). The line passes the top right corner of the left one
    and the top left corner of the right one.
    For a unit normal a the tolerance is half the largest a . (p - q) with p among the left corners
    and the right book's, q among the right corners and the left book's. That is a support function,
    least at the normal of an edge of the hull of all p - q or, if the origin lies outside, towards
    its nearest point.
    """
    p = np.concatenate([left, right[:, _TOP_LEFT, None]], axis=1)
    q = np.concatenate([right, left[:, _TOP_RIGHT, None]], axis=1)
    points = (p[:, :, None] - q[:, None]).reshape(len(p), -1, 2)
    i, j = np.triu_indices(points.shape[1], 1)
    edge = points[:, j] - points[:, i]
    length = np.linalg.norm(edge, axis=-1, keepdims=True)
    normal = np.stack([edge[..., 1], -edge[..., 0]], axis=-1) / np.maximum(length, 1e-12)
    radius = np.linalg.norm(points, axis=-1, keepdims=True)
    towards = -points / np.maximum(radius, 1e-12)
    directions = np.concatenate([normal, -normal, towards], axis=1)
    degenerate = np.linalg.norm(directions, axis=-1) < 0.5
    reach = np.einsum("sdk,spk->sdp", directions, points).max(axis=-1)
    reach = np.where(degenerate, np.inf, reach)
    rows, best = np.arange(len(p)), np.argmin(reach, axis=1)
    chosen = directions[rows, best]
    last = np.einsum("sk,spk->sp", chosen, p).max(axis=1)
    first = np.einsum("sk,spk->sp", chosen, q).min(axis=1)
    return CornerLine(chosen, 0.5 * (last + first), 0.5 * reach[rows, best])
