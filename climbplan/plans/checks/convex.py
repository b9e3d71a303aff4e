"""Distances of convex bodies and depths of segments in them, from corners alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from climbplan.plans.checks.check import Array
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import SLAB_THICKNESS, Region

_BISECTIONS = 60  # halvings of a unit interval: down to rounding


@dataclass(frozen=True)
class ConvexBody:
    """The hull of corners as {x : normals x <= offsets} with unit normals."""

    name: str
    corners: Array  # (V, 3) [m]
    normals: Array  # (F, 3)
    offsets: Array  # (F,) [m]

    def face_distances(self, points: Array) -> Array:
        """Signed distances (..., F) of points (..., 3) from the planes of all faces."""
        return points @ self.normals.T - self.offsets


def hull_of(name: str, corners: Array) -> ConvexBody:
    """The hull of points (V, 3) that span a volume."""
    hull = ConvexHull(corners)
    planes = np.unique(hull.equations.round(12), axis=0)
    return ConvexBody(name, corners, planes[:, :3], -planes[:, 3])


def polygon_normal(corners: Array) -> Array:
    """Unit normal (3,) of a polygon (V, 3), towards where its corners run anticlockwise."""
    spokes = corners[1:] - corners[0]
    normal = np.cross(spokes[:-1], spokes[1:]).sum(axis=0)
    return normal / np.linalg.norm(normal)


def solids_of(terrain: Terrain) -> tuple[ConvexBody, ...]:
    """Obstacles, then the material behind every flat surface."""
    solids = [hull_of(solid.name, solid.vertices) for solid in terrain.obstacles]
    for surface in terrain.surfaces:
        if isinstance(surface, Region):
            corners = surface.vertices
            behind = corners - SLAB_THICKNESS * polygon_normal(corners)
            solids.append(hull_of(surface.name, np.vstack([corners, behind])))
    return tuple(solids)


def hull_distance(first: Array, second: Array) -> float:
    """A lower bound on the distance of the hulls of (V, 3) and (W, 3), exact up to rounding.

    Least-norm point of the hull of all differences, by non-negative least squares (Lawson and
    Hanson, least-distance programming); the bound is certified by the separating plane it gives.
    Zero if they meet.
    """
    differences = (first[:, None, :] - second[None, :, :]).reshape(-1, 3)
    system = np.vstack([differences.T, np.ones(len(differences))])
    weights, _ = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
    nearest = weights @ differences
    norm = float(np.linalg.norm(nearest))
    if norm < 1e-12:
        return 0.0
    return max(float((differences @ (nearest / norm)).min()), 0.0)


def clearance_of_hulls(hulls: Array, body: ConvexBody, solid: ConvexBody, enough: float) -> Array:
    """Distances (P,) of moved hulls (P, V, 3) of `body` from a solid, or lower bounds on them.

    A face of either that separates them by `enough` settles it. What is left is measured
    exactly, and hulls that moved less since the last measured one than it has room are not
    measured again. Negative where they overlap: the depth along the least deep face.
    """
    clear = solid.face_distances(hulls).min(axis=1).max(axis=-1)
    open_ = np.flatnonzero(~(clear >= enough))
    if len(open_) == 0:
        return clear
    # The moved hull's own faces, from where its corners went.
    origin, frames = _frames(body.corners, hulls[open_])
    seen = np.einsum("pij,pvj->pvi", frames, solid.corners - origin[:, None, :])
    clear[open_] = np.maximum(clear[open_], body.face_distances(seen).min(axis=1).max(axis=-1))
    last, room = None, 0.0
    for p in open_:
        if clear[p] >= enough or np.isnan(clear[p]):
            continue
        if last is not None:
            moved = np.sqrt(((hulls[p] - last) ** 2).sum(axis=-1).max())
            if room - moved >= enough:
                clear[p] = room - moved
                continue
        distance = hull_distance(hulls[p], solid.corners)
        if distance > 0:
            clear[p] = max(clear[p], distance)
        last, room = hulls[p], clear[p]
    return clear


def _frames(corners: Array, moved: Array) -> tuple[Array, Array]:
    """World origin (P, 3) and world-to-body rotation (P, 3, 3) that took corners to `moved`."""
    centre = corners.mean(axis=0)
    spread = corners - centre
    middle = moved.mean(axis=1)
    # Rigid motion: least squares has no residual, so the linear map is the rotation itself.
    to_world = np.einsum("iv,pvj->pij", np.linalg.pinv(spread), moved - middle[:, None, :])
    return middle - np.einsum("i,pij->pj", centre, to_world), to_world


def segment_separation(starts: Array, ends: Array, solid: ConvexBody, enough: float) -> Array:
    """Least distance (...) of segments from a solid along its faces, negative inside.

    starts, ends: (..., 3). The value is min over the segment of the largest face distance, or a
    lower bound on it that is at least `enough`. A segment meets the solid where it is below zero,
    and is then as deep.
    """
    first, last = solid.face_distances(starts), solid.face_distances(ends)
    separation: Array = np.minimum(first, last).max(axis=-1)
    open_ = ~(separation >= enough)
    if open_.any():
        separation[open_] = _least_of_largest(first[open_], last[open_])
    return separation


def _least_of_largest(first: Array, last: Array) -> Array:
    """min over t in [0, 1] of max_f (1 - t) first + t last, for rows (S, F)."""
    slope = last - first
    low, high = np.zeros(len(first)), np.ones(len(first))
    rows = np.arange(len(first))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        values = first + middle[:, None] * slope
        rising = slope[rows, values.argmax(axis=1)] > 0
        high = np.where(rising, middle, high)
        low = np.where(rising, low, middle)
    at = np.stack([low, high], axis=1)
    values = first[:, None, :] + at[..., None] * slope[:, None, :]
    least: Array = values.max(axis=-1).min(axis=-1)
    return least


def worst_index(values: Sequence[float]) -> int:
    """Index of the smallest value, the first NaN if there is one."""
    return int(np.argmin(np.asarray(values)))
