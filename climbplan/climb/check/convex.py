"""Distances of convex bodies and depths of segments in them, from corners alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from climbplan.arrays import Array
from climbplan.climb.check.anew.kinematics import transform_to_world
from climbplan.terrain.model import STATED, Terrain
from climbplan.terrain.surfaces import SLAB_THICKNESS, Region

_NUM_BISECTIONS = 60  # halvings of a unit interval: down to rounding


@dataclass(frozen=True)
class ConvexBody:
    """The convex hull of corners as {x : normals x <= offsets} with unit normals."""

    name: str
    corners: Array  # (V, 3) [m]
    normals: Array  # (F, 3)
    offsets: Array  # (F,) [m]

    def face_distances(self, points: Array) -> Array:
        """Return signed distances (..., F) of points (..., 3) from the planes of all faces."""
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
            face_distance = (flat @ normal - offset).reshape(points.shape[:-1])
            np.maximum(
                bound, np.minimum(face_distance[..., :-1], face_distance[..., 1:]), out=bound
            )  # NaN stays
        return bound


def build_hull(name: str, corners: Array) -> ConvexBody:
    """Return the convex hull of points (V, 3) that span a volume."""
    hull = ConvexHull(corners)
    planes = np.unique(hull.equations.round(12), axis=0)
    return ConvexBody(name, corners, planes[:, :3], -planes[:, 3])


def compute_polygon_normal(corners: Array) -> Array:
    """Return the unit normal (3,) of a polygon (V, 3), for which its corners run anticlockwise."""
    spokes = corners[1:] - corners[0]
    normal = np.cross(spokes[:-1], spokes[1:]).sum(axis=0)
    return normal / np.linalg.norm(normal)


def build_solids(terrain: Terrain) -> tuple[ConvexBody, ...]:
    """Return obstacles, then the material behind every flat surface except those of a scan.

    For a scan the raw triangles are solid (`climbplan/climb/check/scan.py`).
    """
    solids = [build_hull(solid.name, solid.vertices) for solid in terrain.obstacles]
    for surface in terrain.surfaces:
        if isinstance(surface, Region) and (terrain.scan is None or surface.name in STATED):
            # What toes stay off lies so far behind the places of toes
            behind = surface.standoff * compute_polygon_normal(surface.vertices)
            solids.append(_build_slab(surface.name, surface.vertices - behind))
    return tuple(solids)


def compute_polygon_edges(corners: Array, normal: Array) -> tuple[Array, Array]:
    """Return unit normals (V, 3) of a polygon's edges, outward in its plane, and their offsets
    (V,).
    """
    outward = np.cross(np.roll(corners, -1, axis=0) - corners, normal)
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return outward, (outward * corners).sum(axis=1)


def _build_slab(name: str, corners: Array) -> ConvexBody:
    """Return the material behind a polygon."""
    normal = compute_polygon_normal(corners)
    sides, offsets = compute_polygon_edges(corners, normal)
    front = float(corners[0] @ normal)
    return ConvexBody(
        name,
        np.vstack([corners, corners - SLAB_THICKNESS * normal]),
        np.vstack([normal, -normal, sides]),
        np.concatenate([[front, SLAB_THICKNESS - front], offsets]),
    )


def bound_hull_distance(first: Array, second: Array) -> float:
    """Return a lower bound on the distance of the hulls of (V, 3) and (W, 3), exact up to rounding.

    The least-norm point of the hull of all differences is found by non-negative least squares
    (Lawson and Hanson, least-distance programming). The bound is certified by the separating plane
    of that point. It is zero if the hulls overlap.
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


def measure_body_clearance(
    com: Array, axes: Array, body: ConvexBody, solid: ConvexBody, sufficient: float
) -> Array:
    """Return distances (P,) of a moving body from a solid, or lower bounds of at least
    `sufficient`.

    A face of either body that separates them by `sufficient` decides a pose. Other poses are
    measured exactly, unless the body has moved less since the last measured pose than its clearance
    there. Negative values are depths along the face of least depth.

    Args:
        com: (P, 3) body origins [m].
        axes: (P, 3, 3) body axes as rows.
        body: The body, in its frame.
        solid: The solid.
        sufficient: Distance [m] above which a bound is enough.
    """
    hulls = transform_to_world(com, axes, body.corners)  # (P, V, 3)
    clearance: Array = solid.face_distances(hulls).min(axis=1).max(axis=-1)
    undecided = np.flatnonzero(~(clearance >= sufficient))
    corners_in_body = np.einsum(
        "pij,pvj->pvi", axes[undecided], solid.corners - com[undecided, None, :]
    )
    clearance[undecided] = np.maximum(
        clearance[undecided], body.face_distances(corners_in_body).min(axis=1).max(axis=-1)
    )
    last_hull, last_clearance = hulls[:1], -np.inf
    for p in undecided[clearance[undecided] < sufficient]:  # NaN stays
        displacement = np.sqrt(((hulls[p] - last_hull) ** 2).sum(axis=-1)).max()
        if last_clearance - displacement >= sufficient:
            clearance[p] = last_clearance - displacement
            continue
        distance = bound_hull_distance(hulls[p], solid.corners)
        if distance > 0:
            clearance[p] = max(clearance[p], distance)
        last_hull, last_clearance = hulls[p], clearance[p]
    return clearance


def measure_chain_separation(points: Array, solid: ConvexBody, sufficient: float) -> Array:
    """Return the smallest face distances (..., P-1) of the pieces of polylines from a solid.

    points: (..., P, 3). The value is the minimum over a piece of the largest face distance, or a
    lower bound on it of at least `sufficient`. A piece enters the solid where the value is
    negative, and is then as deep.
    """
    first, last = points[..., :-1, :], points[..., 1:, :]
    separation = solid.separation_by_faces(points)
    is_near = ~(separation >= sufficient)  # NaN stays
    if is_near.any():
        ends = solid.face_distances(first[is_near]), solid.face_distances(last[is_near])
        separation[is_near] = _minimise_maximum(*ends)
    return separation


def _minimise_maximum(first: Array, last: Array) -> Array:
    """Return min_t max_f (1 - t) first + t last over t in [0, 1], for rows (S, F), by bisection."""
    slope = last - first
    low, high = np.zeros(len(first)), np.ones(len(first))
    rows = np.arange(len(first))
    for _ in range(_NUM_BISECTIONS):
        middle = (low + high) / 2
        values = first + middle[:, None] * slope
        rising = slope[rows, values.argmax(axis=1)] > 0
        high = np.where(rising, middle, high)
        low = np.where(rising, low, middle)
    interval = np.stack([low, high], axis=1)
    values = first[:, None, :] + interval[..., None] * slope[:, None, :]
    minimum: Array = values.max(axis=-1).min(axis=-1)
    return minimum
