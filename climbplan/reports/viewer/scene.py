"""What a plan of any kind looks like over time: the viewer draws this and knows no robots.

A scene is sampled at F times. Rods, boxes, solids and their frames move linearly between samples;
forces, cones and captions belong to the sample at or before the time shown. World frame, z up,
metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, IntArray


@dataclass(frozen=True)
class StaticMesh:
    """Something that stands still: triangles."""

    name: str
    vertices: Array  # (V, 3) [m]
    faces: IntArray  # (F, 3)
    color: str  # "#rrggbb"
    opacity: float = 1.0
    note: str = ""  # shown beside it, such as its friction


@dataclass(frozen=True)
class StaticLines:
    """Line segments that stand still."""

    name: str
    ends: Array  # (K, 2, 3) [m]
    color: str


@dataclass(frozen=True)
class Rods:
    """Links as round rods with balls at both ends."""

    ends: Array  # (F, K, 2, 3) [m]
    radius: Array  # (K,) [m]
    color: tuple[str, ...]  # (K,)
    load: Array | None = None  # (F, K) largest share of a limit that the link's motors use


@dataclass(frozen=True)
class Boxes:
    """Cuboids that move, bodies and books."""

    center: Array  # (F, K, 3) [m]
    rotation: Array  # (F, K, 3, 3) box to world
    size: Array  # (F, K, 3) edge lengths [m]; zeros hide one
    color: tuple[str, ...]  # (K,)
    opacity: float = 1.0


@dataclass(frozen=True)
class Solids:
    """Triangles that move, links of a robot."""

    vertices: tuple[Array, ...]  # K of (V, 3) in their own frames [m]
    faces: tuple[IntArray, ...]  # K of (T, 3)
    position: Array  # (F, K, 3) of their frames [m]
    rotation: Array  # (F, K, 3, 3) own to world
    color: tuple[str, ...]  # (K,)
    load: Array | None = None  # (F, K) largest share of a limit that the piece's motor uses


@dataclass(frozen=True)
class ForceArrows:
    """Forces at points, with friction cones where they press on something."""

    point: Array  # (F, K, 3) [m]
    force: Array  # (F, K, 3) [N], zeros where there is none
    normal: Array  # (F, K, 3) unit, zeros: no cone
    mu: Array  # (F, K)


@dataclass(frozen=True)
class ViewerScene:
    """All that is drawn of a plan."""

    title: str
    facts: tuple[str, ...]  # lines about the whole plan
    time: Array  # (F,) [s], not decreasing; a repeated time is a jump
    caption: tuple[str, ...]  # (F,)
    marks: IntArray  # samples worth stopping at, increasing
    shapes: tuple[StaticMesh, ...] = ()
    paths: tuple[StaticLines, ...] = ()
    rods: Rods | None = None
    boxes: Boxes | None = None
    solids: Solids | None = None
    forces: ForceArrows | None = None
    lower: Array = field(default_factory=lambda: -np.ones(3))  # [m] of what is worth seeing
    upper: Array = field(default_factory=lambda: np.ones(3))
    azimuth_deg: float = -63.0  # where it is first seen from, about z from x
    elevation_deg: float = 18.0

    def moment(self, time: float) -> tuple[int, int, float]:
        """Return samples before and after a time, and the share of the way from one to the other.

        At a jump (a repeated time) it is the later sample that counts.
        """
        last = len(self.time) - 1
        before = int(np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, last))
        after = min(before + 1, last)
        span = float(self.time[after] - self.time[before])
        fraction = 0.0 if span <= 0 else float(np.clip((time - self.time[before]) / span, 0.0, 1.0))
        return before, after, fraction


def interpolate(values: Array, moment: tuple[int, int, float]) -> Array:
    """Return samples (F, ...) at a moment, linearly between the two beside it."""
    before, after, fraction = moment
    blended: Array = (1.0 - fraction) * values[before] + fraction * values[after]
    return blended


def build_polygons(
    name: str, corners: list[Array], color: str, opacity: float, note: str = ""
) -> StaticMesh:
    """Return flat convex polygons as one shape, each a fan of triangles.

    Args:
        name: Name of the shape.
        corners: Corners (V, 3) [m] of each polygon in turn, world frame.
        color: "#rrggbb".
        opacity: From 0 to 1.
        note: Text for people who point at the shape.

    Raises:
        ValueError: There is no polygon.
    """
    fans, start = [], 0
    for polygon in corners:
        count = len(polygon)
        fan = np.column_stack(
            [np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)]
        )
        fans.append(start + fan)
        start += count
    faces = np.concatenate(fans).astype(np.int64)
    return StaticMesh(name, np.concatenate(corners), faces, color, opacity, note)


def compute_outline(shape: StaticMesh) -> IntArray:
    """Return edges (K, 2) of a shape that one of its triangles alone has, or that two meet at an
    angle.
    """
    corners = shape.vertices[shape.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # Shapes may hold a corner once for each of their faces: those at one place are one
    _, same = np.unique(shape.vertices.round(6), axis=0, return_inverse=True)
    directed_edges = np.concatenate(
        [shape.faces[:, [0, 1]], shape.faces[:, [1, 2]], shape.faces[:, [2, 0]]]
    )
    edges, first, edge_index = np.unique(
        np.sort(same.reshape(-1)[directed_edges], axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    total = np.zeros((len(edges), 3))
    np.add.at(total, edge_index.reshape(-1), np.tile(normal, (3, 1)))
    count = np.bincount(edge_index.reshape(-1), minlength=len(edges))
    flat = (count == 2) & (np.linalg.norm(total, axis=1) > 2 - 1e-6)
    outline_edges: IntArray = directed_edges[first[~flat]].astype(np.int64)
    return outline_edges


_CUBE_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def build_block(
    name: str, lower: Array, upper: Array, color: str, opacity: float, yaw: float = 0.0
) -> StaticMesh:
    """Return a cuboid that stands still.

    Args:
        name: Name of the shape.
        lower: (3,) lower corner [m] before the rotation, world frame.
        upper: (3,) upper corner [m] before the rotation, world frame.
        color: "#rrggbb".
        opacity: From 0 to 1.
        yaw: Rotation about the vertical through its middle [rad].
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    c, s = np.cos(yaw), np.sin(yaw)
    yaw_rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    corners_world = (lower + upper) / 2 + (corners * (upper - lower) / 2) @ yaw_rotation.T
    return build_polygons(name, [corners_world[list(face)] for face in _CUBE_FACES], color, opacity)
