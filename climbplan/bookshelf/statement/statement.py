"""The bookshelf as a mixed-integer bilinear program (chapter 8.1.1).

Stored once for any number of books, in two meanings. `contact`: books on the ground without
overlap, leaning books within the contact gap of what they lean on, the stored order kept.
`published`: the published constraints with their tolerances (facts of the code that goes with
arXiv 2110.00666), one line a pair that passes two given corners where a book leans.

Lengths are in mm, so that the cost is in mm^2 as published. Corners are numbered from the top
right clockwise; book n is the inserted one.

Published methods, and equation and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from climbplan.bookshelf.scene.shelf_scene import BookState, Shelf
from climbplan.bookshelf.schema.model import Meaning
from climbplan.program import Program
from climbplan.program.statement import Expression

TOP_RIGHT, BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT = range(4)
ACROSS = np.array([0.5, 0.5, -0.5, -0.5])  # of each corner from the centre, in widths
UP = np.array([0.5, -0.5, -0.5, 0.5])  # in heights
INSERTED_STATES = (BookState.FLAT_LEFT, BookState.UPRIGHT, BookState.FLAT_RIGHT)


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of equations and inequalities."""

    length: float  # [mm] of everything between points
    sine: float  # of a state's angle


@dataclass(frozen=True)
class _ShelfRectangle:
    """The rectangle in which corners lie [mm]."""

    left: float
    right: float
    height: float


@dataclass(frozen=True)
class _Books:
    """Variables of n stored books and the inserted one; lean binaries of the stored ones only."""

    size: Expression  # (n + 1, 2) height, width [mm], a parameter
    center: Expression  # (n + 1, 2) [mm]
    cos: Expression  # (n + 1,)
    sin: Expression  # (n + 1,) > 0: tilts to the left
    vertex: Expression  # (n + 1, 4, 2) [mm]
    lean_left: Expression  # (n,) binary
    lean_right: Expression  # (n,) binary


def list_pairs(n: int) -> list[tuple[int, int]]:
    """List the pairs of books (i < j), the inserted one included."""
    return list(itertools.combinations(range(n + 1), 2))


def build_bookshelf_program(n: int, shelf: Shelf, meaning: Meaning = "contact") -> Program:
    """Insert one book among n stored ones with the least movement.

    Parameters: `size` (n + 1, 2) height, width [mm]; `pose` (n, 3) x [mm], y [mm], angle [rad] of
    the stored books before the insertion.
    """
    frame, tolerance = _build_frame(shelf, meaning)
    p = Program(f"bookshelf, {n} stored books, {meaning}")
    size, pose = p.parameter("size", (n + 1, 2)), p.parameter("pose", (n, 3))
    height, width = size[:, 0], size[:, 1]

    slack = tolerance.length
    low, high = np.array([frame.left, 0.0]), np.array([frame.right, frame.height])
    center = p.continuous("center", (n + 1, 2), low, high, unit="mm")
    cos = p.continuous("cos", (n + 1,), 0.0, 1.0)  # eq. (8.4)
    sin = p.continuous("sin", (n + 1,), -1.0, 1.0)  # > 0: tilts to the left
    # Eq. (8.2), corners inside the shelf, is their bounds
    vertex = p.continuous("vertex", (n + 1, 4, 2), low - slack, high + slack, unit="mm")

    # Rotation, eq. (8.3)
    p.equal("book.rotation", cos**2 + sin**2 - 1)

    # Corners, eq. (8.1)
    across, up = np.outer(width, ACROSS), np.outer(height, UP)
    rotated = np.stack(
        [across * cos[:, None] - up * sin[:, None], across * sin[:, None] + up * cos[:, None]], 2
    )
    p.equal("book.corners", vertex - center[:, None] - rotated, unit="mm")

    max_offset = math.hypot(max(-frame.left, frame.right), frame.height) + slack
    normal, offset = _add_separating_lines(p, vertex, max_offset, slack)

    # Each stored book has one of five states, the inserted one of three
    stored = p.binary("state", (n, len(BookState)))
    inserted = p.binary("inserted_state", (len(INSERTED_STATES),))
    p.exactly_one("book.one_state", stored)
    p.exactly_one("book.one_inserted_state", inserted)
    flat_left = np.append(stored[:, BookState.FLAT_LEFT], inserted[[0]])
    upright = np.append(stored[:, BookState.UPRIGHT], inserted[[1]])
    flat_right = np.append(stored[:, BookState.FLAT_RIGHT], inserted[[2]])
    lean_left, lean_right = stored[:, BookState.LEAN_LEFT], stored[:, BookState.LEAN_RIGHT]

    books = _Books(size, center, cos, sin, vertex, lean_left, lean_right)

    _add_flat_and_upright(p, books, (flat_left, upright, flat_right), tolerance)
    foot_left, foot_right = _add_leaning(p, books, tolerance)
    if meaning == "contact":
        _add_stability(p, shelf, books)
        _add_contact(p, shelf, books)
        _add_order(p, (frame.left, frame.right), center[:n], foot_left, foot_right, stored)
    else:
        _add_published_support(p, shelf, books, normal, offset)

    # Movement of the stored books; the inserted one is free
    p.minimise("translation", np.sum((center[:n] - pose[:, :2]) ** 2))
    p.minimise(
        "rotation", sum((c - ca.cos(a)) ** 2 for c, a in zip(cos[:n], pose[:, 2], strict=True))
    )
    return p


def _add_separating_lines(
    p: Program, vertex: Expression, max_offset: float, slack: float
) -> tuple[Expression, Expression]:
    """Add a separating line for each pair of books, eq. (8.5); returns normals and offsets.

    Normals are unit vectors, which makes offsets distances from the origin [mm].
    """
    i, j = np.transpose(list_pairs(len(vertex) - 1))
    normal = p.continuous("normal", (len(i), 2), -1.0, 1.0)
    offset = p.continuous("offset", (len(i),), -max_offset, max_offset, unit="mm")
    p.equal("line.unit", np.sum(normal**2, axis=1) - 1)
    left_value = np.sum(normal[:, None] * vertex[i], axis=2) - offset[:, None]
    right_value = np.sum(normal[:, None] * vertex[j], axis=2) - offset[:, None]
    p.between("line.left", left_value, -np.inf, slack, unit="mm")
    p.between("line.right", right_value, -slack, np.inf, unit="mm")
    return normal, offset


def _add_flat_and_upright(
    p: Program,
    books: _Books,
    states: tuple[Expression, Expression, Expression],
    tolerance: Tolerances,
) -> None:
    """Add angle and ground contact of flat and upright books, eqs. (8.6) to (8.8).

    states: binaries (n + 1,) of flat left, upright and flat right.
    """
    flat_left, upright, flat_right = states
    slack, off = tolerance.length, tolerance.sine
    height, width = books.size[:, 0], books.size[:, 1]
    for name, state, sine, rise in (
        ("flat_left", flat_left, 1.0, width / 2),
        ("upright", upright, 0.0, height / 2),
        ("flat_right", flat_right, -1.0, width / 2),
    ):
        p.when(f"{name}.angle", state, books.sin, sine - off, sine + off)
        p.when(f"{name}.ground", state, books.center[:, 1] - rise, -slack, slack, unit="mm")


def _add_leaning(p: Program, books: _Books, tolerance: Tolerances) -> tuple[Expression, Expression]:
    """Add angle and ground contact of leaning books, eqs. (8.9), (8.10), with K3, L3.

    Returns the lower corners (n, 2) on which books rest that lean to the left and to the right.
    """
    lean_left, lean_right = books.lean_left, books.lean_right
    n, slack, off = len(lean_left), tolerance.length, tolerance.sine
    foot_left, foot_right = books.vertex[:n, BOTTOM_LEFT], books.vertex[:n, BOTTOM_RIGHT]
    p.when("lean_left.angle", lean_left, books.sin[:n], lower=-off)
    p.when("lean_right.angle", lean_right, books.sin[:n], upper=off)
    p.when("lean_left.ground", lean_left, foot_left[:, 1], -slack, slack, unit="mm")
    p.when("lean_right.ground", lean_right, foot_right[:, 1], -slack, slack, unit="mm")
    return foot_left, foot_right


def _build_frame(shelf: Shelf, meaning: Meaning) -> tuple[_ShelfRectangle, Tolerances]:
    if meaning == "contact":
        frame = _ShelfRectangle(1e3 * shelf.left, 1e3 * shelf.right, 1e3 * shelf.height)
        return frame, Tolerances(0.0, 0.0)
    rules = shelf.published
    half = 1e3 * rules.half_width
    return _ShelfRectangle(-half, half, 1e3 * rules.height), Tolerances(
        1e3 * rules.distance, rules.sine
    )


def _add_stability(p: Program, shelf: Shelf, books: _Books) -> None:
    """Add K2 without its neighbour: |a| >= atan(W / H) + margin puts the centre beyond the foot."""
    lean_left, lean_right = books.lean_left, books.lean_right
    n = len(lean_left)
    size, cos, sin = books.size[:n], books.cos[:n], books.sin[:n]
    height, width = size[:, 0], size[:, 1]
    diagonal = np.array([ca.sqrt(h**2 + w**2) for h, w in size], dtype=object)
    cm, sm = math.cos(shelf.lean_margin), math.sin(shelf.lean_margin)
    min_tilt_cos = (height * cm - width * sm) / diagonal
    min_tilt_sin = (width * cm + height * sm) / diagonal
    p.when("lean_left.stable", lean_left, sin * min_tilt_cos - cos * min_tilt_sin, lower=0.0)
    p.when("lean_right.stable", lean_right, -sin * min_tilt_cos - cos * min_tilt_sin, lower=0.0)


def _add_contact(p: Program, shelf: Shelf, books: _Books) -> None:
    """Add K1, L1: a point of a leaning book is within the contact gap of its support."""
    size, center, vertex = books.size, books.center, books.vertex
    lean_left, lean_right = books.lean_left, books.lean_right
    n = len(lean_left)
    wall = 1e3 * shelf.wall_gap
    left, right = 1e3 * shelf.left, 1e3 * shelf.right
    p.when("lean_left.wall", lean_left[0], vertex[0, TOP_LEFT, 0] - left, upper=wall, unit="mm")
    p.when(
        "lean_right.wall",
        lean_right[-1],
        right - vertex[n - 1, TOP_RIGHT, 0],
        upper=wall,
        unit="mm",
    )
    if n == 1:
        return
    # One point in each of two neighbours, in fractions of width and height from the centre
    fraction = p.continuous("touch.share", (n - 1, 2, 2), -0.5, 0.5)
    points = []
    for side, book in enumerate((slice(0, n - 1), slice(1, n))):
        across, up = fraction[:, side, 0] * size[book, 1], fraction[:, side, 1] * size[book, 0]
        c, s = books.cos[book], books.sin[book]
        points.append(center[book] + np.stack([across * c - up * s, across * s + up * c], axis=1))
    gap = 1e3 * shelf.book_gap
    max_distance = math.hypot(right - left, 1e3 * shelf.height)
    difference = p.continuous("touch.apart", (n - 1, 2), -max_distance, max_distance, unit="mm")
    p.equal("touch.points", difference - points[1] + points[0], unit="mm")
    # In gaps: a square in mm^2 would be scaled unlike the rest
    reach = np.sum(difference**2, axis=1) / max(gap, 1e-3)
    p.when("lean_left.touch", lean_left[1:], reach, upper=gap, unit="mm")
    p.when("lean_right.touch", lean_right[:-1], reach, upper=gap, unit="mm")


def _add_order(
    p: Program,
    sides: tuple[float, float],
    center: Expression,
    foot_left: Expression,
    foot_right: Expression,
    stored: Expression,
) -> None:
    """Add the order of the stored books' centres and feet."""
    n = len(center)
    foot = p.continuous("foot", (n,), *sides, unit="mm")
    resting = stored[:, [BookState.FLAT_LEFT, BookState.UPRIGHT, BookState.FLAT_RIGHT]]
    lean_left, lean_right = stored[:, BookState.LEAN_LEFT], stored[:, BookState.LEAN_RIGHT]
    middle = (foot - center[:, 0])[:, None] + np.zeros((1, 3))
    p.when("foot.resting", resting, middle, 0.0, 0.0, unit="mm")
    p.when("foot.lean_left", lean_left, foot - foot_left[:, 0], 0.0, 0.0, unit="mm")
    p.when("foot.lean_right", lean_right, foot - foot_right[:, 0], 0.0, 0.0, unit="mm")
    if n > 1:
        p.between("order.centers", center[1:, 0] - center[:-1, 0], 0.0, np.inf, unit="mm")
        p.between("order.feet", foot[1:] - foot[:-1], 0.0, np.inf, unit="mm")


def _add_published_support(
    p: Program, shelf: Shelf, books: _Books, normal: Expression, offset: Expression
) -> None:
    """Add eqs. (8.9), (8.10) as published.

    The line passes the upper corners that face each other. The centre is between the foot of the
    book and the neighbour's centre or the wall.
    """
    vertex, lean_left, lean_right = books.vertex, books.lean_left, books.lean_right
    n, rules = len(lean_left), shelf.published
    slack, half = 1e3 * rules.distance, 1e3 * rules.half_width
    number = {pair: k for k, pair in enumerate(list_pairs(n))}
    wall_left = vertex[0, TOP_LEFT, 0] + half - 1e3 * rules.left_wall
    wall_right = half - vertex[n - 1, TOP_RIGHT, 0]
    p.when("lean_left.wall", lean_left[0], wall_left, upper=slack, unit="mm")
    p.when("lean_right.wall", lean_right[-1], wall_right, upper=slack, unit="mm")
    for k in range(n - 1):
        a, b = normal[number[k, k + 1]], offset[number[k, k + 1]]
        upper = np.array([vertex[k, TOP_RIGHT] @ a - b, vertex[k + 1, TOP_LEFT] @ a - b])
        p.when(f"lean_right.line[{k}]", lean_right[k], upper, -slack, slack, unit="mm")
        p.when(f"lean_left.line[{k + 1}]", lean_left[k + 1], upper, -slack, slack, unit="mm")
    x = books.center[:n, 0]
    before, after = np.append(-half, x[:-1]), np.append(x[1:], half)
    foot_left, foot_right = vertex[:n, BOTTOM_LEFT, 0], vertex[:n, BOTTOM_RIGHT, 0]
    between_left = np.stack([x - before, foot_left - x], axis=1)
    between_right = np.stack([after - x, x - foot_right], axis=1)
    p.when("lean_left.stable", lean_left[:, None], between_left, lower=-slack, unit="mm")
    p.when("lean_right.stable", lean_right[:, None], between_right, lower=-slack, unit="mm")
