"""Between placements and points of the statement, with the lines and touching points they need."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.check.published import line_past_corners
from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.rectangles import corners, half_extents, slots
from climbplan.bookshelf.scene.shelf_scene import Scene, State
from climbplan.bookshelf.statement.statement import INSERTED_STATES, pairs
from climbplan.program import Program

_TO_MM = np.array([1e3, 1e3, 1.0])


def theta_of(scene: Scene) -> dict[str, Array]:
    """Parameters of the statement [mm, rad]."""
    return {"size": 1e3 * scene.sizes, "pose": scene.pose * _TO_MM}


def scene_of(theta: Mapping[str, Array]) -> Scene:
    """The scene that parameters of the statement [mm, rad] describe."""
    size = np.asarray(theta["size"]) / 1e3
    return Scene(np.asarray(theta["pose"]) / _TO_MM, size[:-1], size[-1])


def features_of(theta: dict[str, Array]) -> Array:
    """What learned methods compare (5 n + 2,): x, y, angle, height, width of the stored books, then
    height and width of the inserted one [mm, rad], as published."""
    size = theta["size"]
    return np.concatenate([np.hstack([theta["pose"], size[:-1]]).ravel(), size[-1]])


def point_of(program: Program, scene: Scene, placement: Placement) -> Array:
    """The point (N,) of the statement that a placement stands for.

    Lines part two books at their best; where the statement is the published one and a book leans,
    they pass the upper corners as nearly as they can.
    """
    pose, size = placement.pose * _TO_MM, 1e3 * scene.sizes
    n, angle = scene.count, pose[:, 2]
    vertex = corners(pose, size)
    normal, offset = _lines(vertex, angle)
    state = np.eye(len(State))[placement.state]
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
        values["foot"] = _feet(vertex, pose, placement.state)[:n]
        if n > 1:
            values["touch.share"], values["touch.apart"] = _touches(vertex, pose, size)
    else:
        _lean_on_lines(vertex, placement.state, normal, offset)
    return program.point(values)


def placement_of(program: Program, scene: Scene, x: Array) -> Placement:
    """The placement that a point (N,) of the statement stands for, integers rounded."""
    cos, sin = program.value("cos", x), program.value("sin", x)
    angle = np.arctan2(sin, np.maximum(cos, 0.0))
    state = np.argmax(program.value("state", x), axis=1)
    inserted = INSERTED_STATES[int(np.argmax(program.value("inserted_state", x)))]
    pose = np.column_stack([program.value("center", x), angle]) / _TO_MM
    return _placement(scene, pose, np.append(state, int(inserted)))


def settled(scene: Scene, placement: Placement) -> Placement:
    """The same placement with the angles that its states demand and every book on the ground."""
    pose = placement.pose.copy()
    for value, angle in ((State.FLAT_LEFT, 90), (State.UPRIGHT, 0), (State.FLAT_RIGHT, -90)):
        pose[placement.state == value, 2] = math.radians(angle)
    pose[:, 1] = half_extents(pose[:, 2], scene.sizes)[:, 1]
    return Placement(pose, placement.state, placement.slot)


def as_stored(scene: Scene) -> Placement:
    """The stored books where they are and the inserted one upright in the middle of the widest gap,
    which need not be wide enough: the manual start of chapter 8.1.3.2."""
    n = scene.count
    reach = half_extents(scene.pose[:, 2], scene.size)
    tilt = np.abs(scene.pose[:, 2])
    state = np.where(scene.pose[:, 2] > 0, State.LEAN_LEFT, State.LEAN_RIGHT)
    flat = np.where(scene.pose[:, 2] > 0, State.FLAT_LEFT, State.FLAT_RIGHT)
    state = np.where(tilt > math.pi / 2 - 0.02, flat, np.where(tilt < 0.02, State.UPRIGHT, state))
    ends = np.stack([scene.pose[:, 0] - reach[:, 0], scene.pose[:, 0] + reach[:, 0]])
    gaps = ends[0, 1:] - ends[1, :-1]
    middle = 0.5 * (ends[0, 1:] + ends[1, :-1])
    slot = 1 + int(np.argmax(gaps)) if n > 1 else 1
    x = middle[slot - 1] if n > 1 else ends[1, 0] + scene.inserted[1] / 2
    pose = np.vstack([scene.pose, [x, scene.inserted[0] / 2, 0.0]])
    return _placement(scene, pose, np.append(state, int(State.UPRIGHT)))


def _placement(scene: Scene, pose: Array, state: IntArray) -> Placement:
    slot = int(slots(pose[None], scene.sizes[None])[0])
    return Placement(pose, state.astype(np.int64), slot)


def _lines(vertex: Array, angle: Array) -> tuple[Array, Array]:
    """Unit normals (K, 2) from the first to the second book of each pair, and offsets (K,)."""
    n = len(vertex) - 1
    normal, offset = np.zeros((len(pairs(n)), 2)), np.zeros(len(pairs(n)))
    for k, (i, j) in enumerate(pairs(n)):
        turn = np.array([angle[i], angle[j]])[:, None] + np.arange(4) * np.pi / 2
        axes = np.stack([np.cos(turn.ravel()), np.sin(turn.ravel())], axis=1)
        last, first = (vertex[i] @ axes.T).max(axis=0), (vertex[j] @ axes.T).min(axis=0)
        best = int(np.argmax(first - last))
        normal[k], offset[k] = axes[best], 0.5 * (first + last)[best]
    return normal, offset


def _feet(vertex: Array, pose: Array, state: IntArray) -> Array:
    left, right = vertex[:, 2, 0], vertex[:, 1, 0]
    foot = np.where(state == State.LEAN_LEFT, left, pose[:, 0])
    return np.where(state == State.LEAN_RIGHT, right, foot)


def _touches(vertex: Array, pose: Array, size: Array) -> tuple[Array, Array]:
    """Nearest points of neighbouring stored books, as shares (n - 1, 2, 2), and from the first to
    the second (n - 1, 2) [mm]."""
    n = len(pose) - 1
    share, apart = np.zeros((n - 1, 2, 2)), np.zeros((n - 1, 2))
    for k in range(n - 1):
        best = math.inf
        for mine, other in ((k, k + 1), (k + 1, k)):
            for corner in vertex[mine]:
                at = _nearest(corner, pose[other], size[other])
                point = _in_world(at, pose[other], size[other])
                if (length := math.dist(corner, point)) < best:
                    best = length
                    own = _nearest(corner, pose[mine], size[mine])
                    share[k] = [own, at] if mine == k else [at, own]
                    apart[k] = point - corner if mine == k else corner - point
    return share, apart


def _nearest(point: Array, pose: Array, size: Array) -> Array:
    """The point of a book nearest to a point, in shares of its width and height."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = point - pose[:2]
    own = np.array([dx * c + dy * s, dy * c - dx * s]) / size[::-1]
    return np.clip(own, -0.5, 0.5)


def _in_world(share: Array, pose: Array, size: Array) -> Array:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    across, up = share * size[::-1]
    return np.array([pose[0] + across * c - up * s, pose[1] + across * s + up * c])


def _lean_on_lines(vertex: Array, state: IntArray, normal: Array, offset: Array) -> None:
    """Put the lines of leaning books where the published statement wants them."""
    number = {pair: k for k, pair in enumerate(pairs(len(vertex) - 1))}
    for k in range(len(vertex) - 2):
        if state[k] == State.LEAN_RIGHT or state[k + 1] == State.LEAN_LEFT:
            line = line_past_corners(vertex[None, k], vertex[None, k + 1])
            row = number[k, k + 1]
            normal[row], offset[row] = line.normal[0], line.offset[0]
