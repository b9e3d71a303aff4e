"""Convex solids by their corners and faces."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.schema.terrain.terrain import SolidSpec

_MERGE = 1e-9  # [m] faces closer than this are one


@dataclass(frozen=True)
class Solid:
    """A convex body {x : A x <= b} with unit rows of A."""

    name: str
    vertices: Array  # (V, 3) [m]
    A: Array  # (F, 3) outward unit normals
    b: Array  # (F,) [m]

    @classmethod
    def from_points(cls, name: str, points: Array) -> Self:
        """Build the hull of points (K, 3).

        Raises:
            UsageError: It has no volume.
        """
        try:
            hull = ConvexHull(points)
        except QhullError as error:
            raise UsageError(f"solid {name!r}: its points span no volume") from error
        # Qhull splits faces into triangles: keep each plane once.
        planes = np.unique(np.round(hull.equations / _MERGE) * _MERGE, axis=0)
        return cls(name, np.asarray(points, float)[hull.vertices], planes[:, :3], -planes[:, 3])

    @classmethod
    def from_box(cls, name: str, lower: Array, upper: Array) -> Self:
        """Build an axis-aligned box."""
        corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))), float)
        faces = np.vstack([np.eye(3), -np.eye(3)])
        return cls(name, corners, faces, np.concatenate([upper, -np.asarray(lower)]).astype(float))

    @classmethod
    def from_spec(cls, spec: SolidSpec) -> Self:
        """Build a box or hull as written in a spec."""
        if spec.vertices is not None:
            return cls.from_points(spec.name, np.array(spec.vertices, float))
        return cls.from_box(spec.name, np.array(spec.lower, float), np.array(spec.upper, float))

    def face_distance(self, points: Array) -> Array:
        """Return the largest face distance of points (..., 3), negative inside.

        It is a lower bound on the distance.
        """
        distance: Array = (points @ self.A.T - self.b).max(axis=-1)
        return distance
