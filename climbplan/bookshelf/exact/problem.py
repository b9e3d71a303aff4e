"""Problem data of the branch and bound, with bounds that hold for whole states.

Length unit mm. Books 0 .. n-1 are the stored ones, n is the inserted one. Flat on the left and flat
on the right are the same rectangle at the same cost, so that a book has four states here. Tilts are
sizes of angles, in [0, pi/2]; the side is in the state.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.pairs import (
    bound_pair_separation,
    fill_angle_box,
    maximise_sinusoid,
    minimise_sinusoid,
)
from climbplan.bookshelf.scene.shelf_scene import Shelf, ShelfScene

FLAT, LEAN_LEFT, UPRIGHT, LEAN_RIGHT = 0, 1, 2, 3

# Columns of `SceneArrays.book`
HEIGHT, WIDTH, X0, Y0, COS0 = 0, 1, 2, 3, 4
LEANS_LEFT = 5  # 1 if the book is tilted to the left before
LEAN_FROM = 6  # least tilt of a leaning book: stability and clear height
BEST_TILT = 7  # tilt of a leaning book that costs least, near enough
ALLOWED = 8  # sum of 2**state
STATE_COST = 9  # + state: least cost of lifting and turning
REACH_LOW = 13  # + state: least half width
REACH_HIGH = 17  # + state: largest half width
_COLUMNS = 21

_PIECES = 3  # parts of a lean interval in the table of state pairs


class SceneArrays(NamedTuple):
    """The data of one scene."""

    stored: int  # n
    book: Array  # (n + 1, columns)
    min_separation: Array  # (n + 1, n + 1, 4, 4) least D of book i left of book j in these states
    left: float
    right: float
    book_gap: float
    wall_gap: float
    cost_limit: float  # no placement on the shelf costs more
    depth: float  # by which books may penetrate each other; 0 but for comparisons


def build_problem(scene: ShelfScene, shelf: Shelf, depth: float = 0.0) -> SceneArrays:
    """Build the problem of inserting the scene's book with minimum movement.

    depth: permitted penetration of books [m].
    """
    n = scene.count
    book = np.zeros((n + 1, _COLUMNS))
    book[:, :2] = 1e3 * scene.sizes
    book[:n, X0] = 1e3 * scene.pose[:, 0]
    book[:n, Y0] = 1e3 * scene.pose[:, 1]
    book[:n, COS0] = np.cos(scene.pose[:, 2])
    book[:n, LEANS_LEFT] = np.sin(scene.pose[:, 2]) >= 0
    problem = SceneArrays(
        stored=n,
        book=book,
        min_separation=np.zeros((n + 1, n + 1, 4, 4)),
        left=1e3 * shelf.left,
        right=1e3 * shelf.right,
        book_gap=1e3 * shelf.book_gap,
        wall_gap=1e3 * shelf.wall_gap,
        cost_limit=0.0,
        depth=1e3 * depth,
    )
    fill_problem(problem, 1e3 * shelf.height, shelf.lean_margin)
    return problem._replace(cost_limit=_bound_cost_above(problem))


def _bound_cost_above(problem: SceneArrays) -> float:
    """Bound the cost of every placement from above."""
    stored = problem.book[:-1]
    far = np.maximum(np.abs(problem.right - stored[:, X0]), np.abs(stored[:, X0] - problem.left))
    lift = np.abs(stored[:, Y0]) + stored[:, HEIGHT] + stored[:, WIDTH]
    return float((far**2 + lift**2 + 4.0).sum()) + 1.0


@compiled
def select_side(state: int) -> float:
    """Return +1 for a tilt to the left (also for flat and upright books), -1 to the right."""
    return -1.0 if state == LEAN_RIGHT else 1.0


@compiled
def fill_problem(problem: SceneArrays, clear: float, margin: float) -> None:
    """Fill the columns that follow from a new problem's sizes and poses, and the table.

    clear: height of the shelf, margin: on top of the least tilt that is stable.
    """
    n, book = problem.stored, problem.book
    box, other_box = np.zeros(7), np.zeros(7)
    for k in range(n + 1):
        h, w = book[k, HEIGHT], book[k, WIDTH]
        allowed = (1 if w <= clear else 0) + (4 if h <= clear else 0)
        if k < n:
            stable, diagonal = math.atan2(w, h), math.hypot(w, h)
            min_tilt = stable + margin
            if w <= clear:
                allowed += 2 + 8
                if diagonal > clear:  # a stable book is the lower the more it leans
                    min_tilt = max(min_tilt, stable + math.acos(clear / diagonal))
            min_tilt = min(min_tilt, math.pi / 2)
            book[k, LEAN_FROM] = min_tilt
            target = min(max(2 * book[k, Y0] / diagonal, -1.0), 1.0)
            book[k, BEST_TILT] = min(max(stable + math.acos(target), min_tilt), math.pi / 2)
        book[k, ALLOWED] = allowed
        for state in range(4):
            fill_angle_box(
                _interpolate_tilt(book, k, state, 0.0), _interpolate_tilt(book, k, state, 1.0), box
            )
            book[k, REACH_LOW + state] = minimise_sinusoid(h / 2, w / 2, box)
            book[k, REACH_HIGH + state] = maximise_sinusoid(h / 2, w / 2, box)
            y, c = book[k, Y0], book[k, COS0]
            lift = max(
                0.0,
                minimise_sinusoid(w / 2, h / 2, box) - y,
                y - maximise_sinusoid(w / 2, h / 2, box),
            )
            turn = max(0.0, box[5] - c, c - box[1])
            book[k, STATE_COST + state] = lift * lift + turn * turn
    for i in range(n + 1):
        for j in range(n + 1):
            if i < j or i == n:  # the inserted book may be on either side
                for pair in range(16):
                    a, b = pair // 4, pair % 4
                    if int(book[i, ALLOWED]) >> a & 1 and int(book[j, ALLOWED]) >> b & 1:
                        problem.min_separation[i, j, a, b] = _bound_state_separation(
                            problem, i, a, j, b, box, other_box
                        )


@compiled
def _interpolate_tilt(book: Array, k: int, state: int, fraction: float) -> float:
    """Return the tilt at a fraction of the interval of a state."""
    if state == FLAT:
        return math.pi / 2
    if state == UPRIGHT:
        return 0.0
    return book[k, LEAN_FROM] + fraction * (math.pi / 2 - book[k, LEAN_FROM])


@compiled
def _bound_state_separation(
    problem: SceneArrays, i: int, a: int, j: int, b: int, box: Array, other_box: Array
) -> float:
    """Bound D over all tilts of two states from below."""
    book = problem.book
    num_pieces_i = _PIECES if a == LEAN_LEFT or a == LEAN_RIGHT else 1
    num_pieces_j = _PIECES if b == LEAN_LEFT or b == LEAN_RIGHT else 1
    lower_bound = np.inf
    for p in range(num_pieces_i):
        fill_angle_box(
            _interpolate_tilt(book, i, a, p / num_pieces_i),
            _interpolate_tilt(book, i, a, (p + 1) / num_pieces_i),
            box,
        )
        for q in range(num_pieces_j):
            fill_angle_box(
                _interpolate_tilt(book, j, b, q / num_pieces_j),
                _interpolate_tilt(book, j, b, (q + 1) / num_pieces_j),
                other_box,
            )
            constant, plane, g, h = bound_pair_separation(
                select_side(a), book[i, WIDTH], book[i, HEIGHT], box,
                select_side(b), book[j, WIDTH], book[j, HEIGHT], other_box, 0.0,
                problem.depth,
            )  # fmt: skip
            lower_bound = min(
                lower_bound, max(constant, plane - abs(g) * box[6] - abs(h) * other_box[6])
            )
    return lower_bound
