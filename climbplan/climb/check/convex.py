"""Distances of convex bodies and depths of segments in them, from corners alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import placed
from climbplan.terrain.model import STATED, Terrain
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

    def separation_by_faces(self, points: Array) -> Array:
        """Return lower bounds (..., P-1) on the distances of polyline pieces from the body.

        points: (..., P, 3) [m]. The largest separation by one face, negative where no face
        separates them. The loop over faces avoids reductions over a short last axis, which NumPy
        does slowly.
        """
        flat = np.ascontiguousarray(points).reshape(-1, 3)
        bound = np.full((*points.shape[:-2], points.shape[-2] - 1), -np.inf)
        for normal, offset in zip(self.normals, self.offsets, strict=True):
            apart = (flat @ normal - offset).reshape(points.shape[:-1])
            np.maximum(bound, np.minimum(apart[..., :-1], apart[..., 1:]), out=bound)  # NaN stays
        return bound


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
    """Obstacles, then the material behind every flat surface but those found in a scan.

    There the raw triangles are what is solid (`climbplan/climb/check/scan.py`).
    """
    solids = [hull_of(solid.name, solid.vertices) for solid in terrain.obstacles]
    for surface in terrain.surfaces:
        if isinstance(surface, Region) and (terrain.scan is None or surface.name in STATED):
            # What toes stay off lies so far behind the places of toes
            behind = surface.standoff * polygon_normal(surface.vertices)
            solids.append(_slab(surface.name, surface.vertices - behind))
    return tuple(solids)


def polygon_edges(corners: Array, normal: Array) -> tuple[Array, Array]:
    """Unit normals (V, 3) of a polygon's edges, outward in its plane, and their offsets (V,)."""
    outward = np.cross(np.roll(corners, -1, axis=0) - corners, normal)
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return outward, (outward * corners).sum(axis=1)


def _slab(name: str, corners: Array) -> ConvexBody:
    """The material behind a polygon."""
    normal = polygon_normal(corners)
    sides, offsets = polygon_edges(corners, normal)
    front = float(corners[0] @ normal)
    return ConvexBody(
        name,
        np.vstack([corners, corners - SLAB_THICKNESS * normal]),
        np.vstack([normal, -normal, sides]),
        np.concatenate([[front, SLAB_THICKNESS - front], offsets]),
    )


def hull_distance(first: Array, second: Array) -> float:
    """A lower bound on the distance of the hulls of (V, 3) and (W, 3), exact up to rounding.

    Least-norm point of the hull of all differences, by non-negative least squares (Lawson and
    Hanson, least-distance programming); the bound is certified by the separating plane it gives.
    Zero if they meet.
    """
    differences = (first[:, None, :] - second[None, :, :]).reshape(-1, 3)
    system = np.vstack([differences.T, np.ones(len(differences))])
    if not np.isfinite(system).all():
        return 0.0
    try:
        weights, _ = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
    except RuntimeError:  # its iteration limit: no better bound is known
        return 0.0
    nearest = weights @ differences
    norm = float(np.linalg.norm(nearest))
    if norm < 1e-12:
        return 0.0
    return max(float((differences @ (nearest / norm)).min()), 0.0)


def body_clearance(
    com: Array, axes: Array, body: ConvexBody, solid: ConvexBody, enough: float
) -> Array:
    """Distances (P,) of a moving body from a solid, or lower bounds that are at least `enough`.

    com: (P, 3) origins, axes: (P, 3, 3) body axes as rows. A face of either that separates them
    by `enough` settles a pose. What is left is measured exactly, unless the body has moved less
    since the last measured pose than it had room there. Negative where they overlap: the depth
    along the least deep face.
    """
    hulls = placed(com, axes, body.corners)  # (P, V, 3)
    clear: Array = solid.face_distances(hulls).min(axis=1).max(axis=-1)
    left = np.flatnonzero(~(clear >= enough))
    seen = np.einsum("pij,pvj->pvi", axes[left], solid.corners - com[left, None, :])
    clear[left] = np.maximum(clear[left], body.face_distances(seen).min(axis=1).max(axis=-1))
    measured, room = hulls[:1], -np.inf
    for p in left[clear[left] < enough]:  # NaN stays
        moved = np.sqrt(((hulls[p] - measured) ** 2).sum(axis=-1)).max()
        if room - moved >= enough:
            clear[p] = room - moved
            continue
        distance = hull_distance(hulls[p], solid.corners)
        if distance > 0:
            clear[p] = max(clear[p], distance)
        measured, room = hulls[p], clear[p]
    return clear


def chain_separation(points: Array, solid: ConvexBody, enough: float) -> Array:
    """Least distances (..., P-1) of the pieces of polylines from a solid along its faces.

    points: (..., P, 3). The value is min over a piece of the largest face distance, or a lower
    bound on it that is at least `enough`. A piece meets the solid where the value is below zero,
    and is then as deep.
    """
    first, last = points[..., :-1, :], points[..., 1:, :]
    separation = solid.separation_by_faces(points)
    near = ~(separation >= enough)  # NaN stays
    if near.any():
        ends = solid.face_distances(first[near]), solid.face_distances(last[near])
        separation[near] = _least_of_largest(*ends)
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
