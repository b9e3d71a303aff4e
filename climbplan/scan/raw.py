"""A scan as it was read: triangles, or points without any, and notes on its processing."""

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
    """A file that cannot become a terrain: what it is, and what was expected."""


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
        """Corners (T, 3, 3) of the triangles [m]."""
        return self.vertices[self.triangles]

    def add_notes(self, *notes: str) -> RawScan:
        """Return the same scan with further notes."""
        return replace(self, notes=(*self.notes, *notes))


def build_mesh(vertices: Array, triangles: IntArray) -> RawScan:
    """Return triangles without materials."""
    return RawScan(
        np.asarray(vertices, float),
        np.asarray(triangles, np.int64).reshape(-1, 3),
        np.zeros(len(triangles), np.int64),
    )


def transform_to_world(raw: RawScan, spec: ScanSpec) -> RawScan:
    """Return the scan in the world frame: scaled, turned upright, and moved as the spec says."""
    rotation = rotation_world_body(np.deg2rad(spec.transform.rpy_deg)) @ np.array(
        _UP[spec.up], float
    )
    vertices = spec.scale * raw.vertices @ rotation.T + np.array(spec.transform.move)
    normals = None if raw.normals is None else raw.normals @ rotation.T
    return replace(raw, vertices=vertices, normals=normals)


def select_within_box(raw: RawScan, lower: Array, upper: Array) -> RawScan:
    """Return what reaches into a box: whole triangles, not cut at its faces.

    Args:
        raw: The scan.
        lower: Lower corner (3,) [m].
        upper: Upper corner (3,) [m].
    """
    if not len(raw.triangles):
        keep = ((raw.vertices >= lower) & (raw.vertices <= upper)).all(axis=1)
        normals = None if raw.normals is None else raw.normals[keep]
        return replace(raw, vertices=raw.vertices[keep], normals=normals)
    corners = raw.corners
    inside = (corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)
    return select_triangles(raw, inside.all(axis=1))


def select_triangles(raw: RawScan, keep: BoolArray) -> RawScan:
    """Return some triangles (T,) and the vertices that they use."""
    vertex_numbers, triangles = np.unique(raw.triangles[keep], return_inverse=True)
    return replace(
        raw,
        vertices=raw.vertices[vertex_numbers],
        triangles=triangles.reshape(-1, 3).astype(np.int64),
        label=raw.label[keep],
    )
