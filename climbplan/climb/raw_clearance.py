"""Room between the robot and the raw surface of a scan, as planning measures it.

The checks measure it again, by other means (`climbplan/climb/check/scan.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import Index
from climbplan.errors import UsageError
from climbplan.robots.rotations import Array
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid

THE_SCAN = "the scan"
_NARROW = 0.05  # [m] last part of a limb, which narrows to its toe
_DEPTH = 0.05  # [m] of material behind a triangle
_CONVEX = 1e-4  # [m] by which corners may stick out of a convex body
_THICK = 1e-3  # [m] of a body
_SAME_PLANE = 1 - 1e-6  # cosine
_AT_TOE = 3e-3  # [m] beyond the flatness, twice: the last of it, which may touch


@dataclass(frozen=True)
class NearestRaw:
    """The link that comes closest to the raw surface, and all that links come too close to."""

    distance: float  # [m] of its axis, or of a narrowed end the same with the links' radius
    index: tuple[int, ...]  # of limb and pose
    link: int
    solids: tuple[Solid, ...]  # what is behind the triangles that are nearer than the room


def closest_raw(scan: RawSurface, points: Array, room: float, radius: float) -> NearestRaw:
    """The least distance of links (..., P, 3) from raw triangles, `room` [m] at most.

    The last 5 cm of a limb narrow to its toe: their axis alone keeps off, up to the toe's own
    place on the surface. Links with NaN are left out.
    """
    from climbplan.scan.distances import nearest_triangles

    starts, ends = points[..., :-1, :], points[..., 1:, :].copy()
    tibia = points[..., -1, :] - points[..., -2, :]
    length = np.maximum(np.linalg.norm(tibia, axis=-1, keepdims=True), 1e-9)
    narrow = points[..., -1, :] - tibia * np.minimum(_NARROW / length, 1.0)
    last = points[..., -1, :] - tibia * np.minimum((2 * scan.flatness + _AT_TOE) / length, 1.0)
    ends[..., -1, :] = narrow
    number = _near(scan, points, room)
    corners = np.ascontiguousarray(scan.corners[number])

    def measured(first: Array, second: Array) -> tuple[Array, Index]:
        begin, end = (np.ascontiguousarray(v.reshape(-1, 3)) for v in (first, second))
        away, triangle = nearest_triangles(begin, end, corners, room)
        shape = first.shape[:-1]
        return away.reshape(shape), triangle.reshape(shape)

    distance, triangle = measured(starts, ends)
    axis, under = measured(narrow, last)
    axis = np.where(axis > 0, axis + radius, 0.0)
    nearer = axis < distance[..., -1]
    distance[..., -1] = np.where(nearer, axis, distance[..., -1])
    triangle[..., -1] = np.where(nearer, under, triangle[..., -1])
    unknown = np.asarray(np.isnan(points).any(axis=(-2, -1)))
    distance = np.where(unknown[..., None], room, distance)
    *index, link = (int(i) for i in np.unravel_index(int(np.argmin(distance)), distance.shape))
    near = np.asarray(distance < room - 1e-9)
    hit = triangle[near & np.asarray(triangle >= 0)]
    solids = _behind(scan, number[np.unique(hit)])
    return NearestRaw(float(distance.min()), tuple(index), link, solids)


def _behind(scan: RawSurface, triangles: Index) -> tuple[Solid, ...]:
    """The material behind some triangles: whole convex bodies, or slabs behind planes."""
    if not len(triangles):
        return ()
    corners = scan.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = doubled / np.linalg.norm(doubled, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    found: dict[str, Solid] = {}
    for t in (int(t) for t in triangles):
        piece = _touching(scan, np.arange(len(corners), dtype=np.int64), t)
        places = corners[piece].reshape(-1, 3)
        heights = normals[piece] @ places.T - offsets[piece, None]
        if heights.max() > _CONVEX or heights.min() > -_THICK:
            # Not a convex body: a slab behind what lies in the triangle's plane
            alike = (normals @ normals[t] > _SAME_PLANE) & (np.abs(offsets - offsets[t]) < _CONVEX)
            places = corners[
                _touching(scan, np.asarray(np.flatnonzero(alike), np.int64), t)
            ].reshape(-1, 3)
            front = places - ((places @ normals[t]) - offsets[t])[:, None] * normals[t]
            places = np.concatenate([front, front - _DEPTH * normals[t]])
        middle = ", ".join(f"{v:.2f}" for v in places.mean(axis=0))
        name = f"{THE_SCAN} about {middle}"
        try:
            found[name] = Solid.from_points(name, places)
        except UsageError:
            continue  # a sliver, which has no material behind it
    return tuple(found.values())


def _touching(scan: RawSurface, candidates: Index, first: int) -> Index:
    """Those of the candidates that are connected with one of them over common corners."""
    own = {first}
    reached = set(scan.triangles[first].tolist())
    left = [t for t in candidates.tolist() if t != first]
    while True:
        more = [t for t in left if reached & set(scan.triangles[t].tolist())]
        if not more:
            return np.array(sorted(own), np.int64)
        own |= set(more)
        left = [t for t in left if t not in own]
        reached |= set(scan.triangles[more].ravel().tolist())


def raw_body_room(scan: RawSurface, hulls: Array, room: float) -> Array:
    """Distances (...) of body hulls (..., V, 3) from raw triangles, `room` [m] at most.

    Corners and edges of the hull against triangles, and these against the hull's faces: zero where
    they meet.
    """
    from climbplan.scan.distances import segment_distances

    flat = hulls.reshape(-1, *hulls.shape[-2:])
    corners = np.ascontiguousarray(scan.corners[_near(scan, hulls, room)])
    out = np.full(len(flat), room)
    if not len(corners):
        return out.reshape(hulls.shape[:-2])
    first, last = np.triu_indices(hulls.shape[-2], k=1)
    centre = flat.mean(axis=1)
    size = np.linalg.norm(flat - centre[:, None], axis=-1).max(axis=1)
    away = segment_distances(centre, centre, corners, float(size.max()) + room)
    for p in np.flatnonzero(away < size + room):
        # All chords between corners: edges among them, and what passes through the hull
        out[p] = segment_distances(flat[p, first], flat[p, last], corners, room).min()
        inside = (_heights(flat[p], corners.reshape(-1, 3)) < room).all(axis=-1)
        if inside.any():
            heights = _heights(flat[p], corners.reshape(-1, 3)[inside]).max(axis=-1)
            out[p] = min(out[p], max(float(heights.min()), 0.0))
    return out.reshape(hulls.shape[:-2])


def _heights(hull: Array, points: Array) -> Array:
    """(P, F) heights of points over the faces of a hull."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(hull).equations
    return points @ planes[:, :3].T + planes[:, 3]


def _near(scan: RawSurface, points: Array, room: float) -> Index:
    """Numbers of triangles whose bounds come within `room` [m] of the bounds of points."""
    flat = points.reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0) - room, np.nanmax(flat, axis=0) + room
    corners = scan.corners
    inside = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return np.asarray(np.flatnonzero(inside.all(axis=1)), np.int64)
