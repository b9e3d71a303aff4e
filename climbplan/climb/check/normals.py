"""Normals of surfaces, from the corners in the plan file."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.convex import compute_polygon_normal
from climbplan.terrain.surfaces import Region, Surface, Tube


def compute_normals(surface: Surface, points: Array) -> Array:
    """Return unit normals into free space at points (P, 3) on or above a surface."""
    if isinstance(surface, Region):
        return np.broadcast_to(compute_polygon_normal(surface.vertices), points.shape)
    if isinstance(surface, Tube):
        inward = np.append(surface.center, 0.0) - points * [1.0, 1.0, 0.0]
        return inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    raise TypeError(f"no normals for surfaces of type {type(surface).__name__}")
