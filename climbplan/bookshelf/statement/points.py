"""Conversion between placements and points of the program, with separating lines and contacts.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.published import fit_corner_line
from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.rectangles import compute_corners, compute_half_extents, find_slots
from climbplan.bookshelf.scene.shelf_scene import BookState, ShelfScene
from climbplan.bookshelf.statement.statement import INSERTED_STATES, list_pairs
from climbplan.program import Program

_TO_MM = np.array([1e3, 1e3, 1.0])


def build_theta(scene: ShelfScene) -> dict[str, Array]:
    """Build the parameters of the program [mm, rad]."""
    return {"size": 1e3 * scene.sizes, "pose": scene.pose * _TO_MM}


def scene_of(theta: Mapping[str, Array]) -> ShelfScene:
    """Return the scene that parameters of the program [mm, rad] describe."""
    size = np.asarray(theta["size"]) / 1e3
    return ShelfScene(np.asarray(theta["pose"]) / _TO_MM, size[:-1], size[-1])


def compute_features(theta: dict[str, Array]) -> Array:
    """Compute the published features (5 n + 2,) [mm, rad] of learned methods.

    They are x, y, angle, height and width of each stored book, then height and width of the
    inserted one.
    """
    size = theta["size"]
    return np.concatenate([np.hstack([theta["pose"], size[:-1]]).ravel(), size[-1]])


def build_point(program: Program, scene: ShelfScene, placement: Placement) -> Array:
    """Build the point (N,) of the program that represents a placement.

    Lines separate two books with the largest margin. In the published statement the line of a
    leaning book passes the upper corners as nearly as possible.
    """
    pose, size = placement.pose * _TO_MM, 1e3 * scene.sizes
    n, angle = scene.count, pose[:, 2]
    vertex = compute_corners(pose, size)
    normal, offset = _find_separating_lines(vertex, angle)
    state = np.eye(len(BookState))[placement.state]
    values = {
        "center": pose[:, :2],
        "cos": np.cos(angle),
        "sin": np.sin(angle),
        "vertex": vertex,
        "normal": normal,
        "offset": offset,
        "state": state[:n],
        "inserted_state": state[n, list(INSERTED_STATES)],
    }
    if "foot" in program.variables:
        values["foot"] = _compute_feet(vertex, pose, placement.state)[:n]
        if n > 1:
            values["touch.share"], values["touch.apart"] = _find_nearest_points(vertex, pose, size)
    else:
        _place_lean_lines(vertex, placement.state, normal, offset)
    return program.point(values)


def extract_placement(program: Program, scene: ShelfScene, x: Array) -> Placement:
    """Extract the placement from a point (N,) of the program, integers rounded."""
    cos, sin = program.value("cos", x), program.value("sin", x)
    angle = np.arctan2(sin, np.maximum(cos, 0.0))
    state = np.argmax(program.value("state", x), axis=1)
    inserted = INSERTED_STATES[int(np.argmax(program.value("inserted_state", x)))]
    pose = np.column_stack([program.value("center", x), angle]) / _TO_MM
    return _build_placement(scene, pose, np.append(state, int(inserted)))


def snap_to_states(scene: ShelfScene, placement: Placement) -> Placement:
    """Set the angles that the states prescribe and put every book on the ground."""
    pose = placement.pose.copy()
    for value, angle in (
        (BookState.FLAT_LEFT, 90),
        (BookState.UPRIGHT, 0),
        (BookState.FLAT_RIGHT, -90),
    ):
        pose[placement.state == value, 2] = math.radians(angle)
    pose[:, 1] = compute_half_extents(pose[:, 2], scene.sizes)[:, 1]
    return Placement(pose, placement.state, placement.slot)


def build_initial_placement(scene: ShelfScene) -> Placement:
    """Build the manual start of chapter 8.1.3.2.

    The stored books stay in place. The inserted one is upright in the middle of the widest gap,
    which need not be wide enough.
    """
    n = scene.count
    reach = compute_half_extents(scene.pose[:, 2], scene.size)
    tilt = np.abs(scene.pose[:, 2])
    state = np.where(scene.pose[:, 2] > 0, BookState.LEAN_LEFT, BookState.LEAN_RIGHT)
    flat = np.where(scene.pose[:, 2] > 0, BookState.FLAT_LEFT, BookState.FLAT_RIGHT)
    state = np.where(
        tilt > math.pi / 2 - 0.02, flat, np.where(tilt < 0.02, BookState.UPRIGHT, state)
    )
    ends = np.stack([scene.pose[:, 0] - reach[:, 0], scene.pose[:, 0] + reach[:, 0]])
    gaps = ends[0, 1:] - ends[1, :-1]
    middle = 0.5 * (ends[0, 1:] + ends[1, :-1])
    slot = 1 + int(np.argmax(gaps)) if n > 1 else 1
    x = middle[slot - 1] if n > 1 else ends[1, 0] + scene.inserted[1] / 2
    pose = np.vstack([scene.pose, [x, scene.inserted[0] / 2, 0.0]])
    return _build_placement(scene, pose, np.append(state, int(BookState.UPRIGHT)))


def _build_placement(scene: ShelfScene, pose: Array, state: IntArray) -> Placement:
    slot = int(find_slots(pose[None], scene.sizes[None])[0])
    return Placement(pose, state.astype(np.int64), slot)


def _find_separating_lines(vertex: Array, angle: Array) -> tuple[Array, Array]:
    """Find separating lines: normals (K, 2) from first to second book of a pair, offsets (K,)."""
    n = len(vertex) - 1
    normal, offset = np.zeros((len(list_pairs(n)), 2)), np.zeros(len(list_pairs(n)))
    for k, (i, j) in enumerate(list_pairs(n)):
        turn = np.array([angle[i], angle[j]])[:, None] + np.arange(4) * np.pi / 2
        axes = np.stack([np.cos(turn.ravel()), np.sin(turn.ravel())], axis=1)
        last, first = (vertex[i] @ axes.T).max(axis=0), (vertex[j] @ axes.T).min(axis=0)
        best = int(np.argmax(first - last))
        normal[k], offset[k] = axes[best], 0.5 * (first + last)[best]
    return normal, offset


def _compute_feet(vertex: Array, pose: Array, state: IntArray) -> Array:
    left, right = vertex[:, 2, 0], vertex[:, 1, 0]
    foot = np.where(state == BookState.LEAN_LEFT, left, pose[:, 0])
    return np.where(state == BookState.LEAN_RIGHT, right, foot)


def _find_nearest_points(vertex: Array, pose: Array, size: Array) -> tuple[Array, Array]:
    """Find the nearest points of neighbouring stored books.

    Returns the points as fractions of width and height (n - 1, 2, 2), and the differences from the
    first to the second point (n - 1, 2) [mm].
    """
    n = len(pose) - 1
    fractions, difference = np.zeros((n - 1, 2, 2)), np.zeros((n - 1, 2))
    for k in range(n - 1):
        best = math.inf
        for book, neighbour in ((k, k + 1), (k + 1, k)):
            for corner in vertex[book]:
                nearest = _project_onto_book(corner, pose[neighbour], size[neighbour])
                point = _transform_to_world(nearest, pose[neighbour], size[neighbour])
                if (length := math.dist(corner, point)) < best:
                    best = length
                    own_point = _project_onto_book(corner, pose[book], size[book])
                    fractions[k] = [own_point, nearest] if book == k else [nearest, own_point]
                    difference[k] = point - corner if book == k else corner - point
    return fractions, difference


def _project_onto_book(point: Array, pose: Array, size: Array) -> Array:
    """Project a point onto a book; returns fractions of its width and height."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = point - pose[:2]
    local = np.array([dx * c + dy * s, dy * c - dx * s]) / size[::-1]
    return np.clip(local, -0.5, 0.5)


def _transform_to_world(fraction: Array, pose: Array, size: Array) -> Array:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    across, up = fraction * size[::-1]
    return np.array([pose[0] + across * c - up * s, pose[1] + across * s + up * c])


def _place_lean_lines(vertex: Array, state: IntArray, normal: Array, offset: Array) -> None:
    """Place the lines of leaning books as the published statement requires."""
    number = {pair: k for k, pair in enumerate(list_pairs(len(vertex) - 1))}
    for k in range(len(vertex) - 2):
        if state[k] == BookState.LEAN_RIGHT or state[k + 1] == BookState.LEAN_LEFT:
            line = fit_corner_line(vertex[None, k], vertex[None, k + 1])
            row = number[k, k + 1]
            normal[row], offset[row] = line.normal[0], line.offset[0]
