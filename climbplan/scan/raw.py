"""A scan as it was read: triangles, or points without any, and what was done to it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.terrain.scan import ScanSpec

# Rows are the world's axes in those of the file, by the axis that points up: right-handed
_UP = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}


class ScanError(UsageError):
    """A file that no terrain can be made of: what it is, and what was expected."""


@dataclass(frozen=True)
class RawScan:
    """Triangles of a file, or points where it has none."""

    vertices: Array  # (V, 3) [m]
    triangles: IntArray  # (T, 3), anticlockwise seen from free space; none in a cloud
    label: IntArray  # (T,) index into `labels`
    labels: tuple[str, ...] = ("",)  # materials or colours
    normals: Array | None = None  # (V, 3) of a cloud that has them
    notes: tuple[str, ...] = field(default=())  # what was found and done, for people

    @property
    def corners(self) -> Array:
        """(T, 3, 3) corners of the triangles [m]."""
        return self.vertices[self.triangles]

    def noted(self, *notes: str) -> RawScan:
        """The same with more said about it."""
        return replace(self, notes=(*self.notes, *notes))


def mesh(vertices: Array, triangles: IntArray) -> RawScan:
    """Triangles without materials."""
    return RawScan(
        np.asarray(vertices, float),
        np.asarray(triangles, np.int64).reshape(-1, 3),
        np.zeros(len(triangles), np.int64),
    )


def placed(raw: RawScan, spec: ScanSpec) -> RawScan:
    """The scan in the world: scaled, turned upright, and moved to where the spec has it."""
    turn = rotation_world_body(np.deg2rad(spec.transform.rpy_deg)) @ np.array(_UP[spec.up], float)
    vertices = spec.scale * raw.vertices @ turn.T + np.array(spec.transform.move)
    normals = None if raw.normals is None else raw.normals @ turn.T
    return replace(raw, vertices=vertices, normals=normals)


def cropped(raw: RawScan, lower: Array, upper: Array) -> RawScan:
    """What reaches into a box: whole triangles, not cut at its faces."""
    if not len(raw.triangles):
        keep = ((raw.vertices >= lower) & (raw.vertices <= upper)).all(axis=1)
        normals = None if raw.normals is None else raw.normals[keep]
        return replace(raw, vertices=raw.vertices[keep], normals=normals)
    corners = raw.corners
    inside = (corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)
    return chosen(raw, inside.all(axis=1))


def chosen(raw: RawScan, keep: BoolArray) -> RawScan:
    """Some triangles, and the vertices that they use."""
    used, triangles = np.unique(raw.triangles[keep], return_inverse=True)
    return replace(
        raw,
        vertices=raw.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int64),
        label=raw.label[keep],
    )
