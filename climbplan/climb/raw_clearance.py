"""Room between the robot and the raw surface of a scan, as planning measures it.

The checks measure it again, by other means (`climbplan/climb/check/scan.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.rotations import Array
from climbplan.terrain.raw_surface import RawSurface

THE_SCAN = "the scan"
_NARROW = 0.05  # [m] last part of a limb, which narrows to its toe
_AT_TOE = 3e-3  # [m] beyond the flatness, twice: the last of it, which may touch


@dataclass(frozen=True)
class NearestRaw:
    """The link that comes closest to the raw surface."""

    distance: float  # [m] of its axis, or of a narrowed end the same with the links' radius
    index: tuple[int, ...]  # of limb and pose
    link: int


def closest_raw(scan: RawSurface, points: Array, room: float, radius: float) -> NearestRaw:
    """The least distance of links (..., P, 3) from raw triangles, `room` [m] at most.

    The last 5 cm of a limb narrow to its toe: their axis alone keeps off, up to the toe's own
    place on the surface. Links with NaN are left out.
    """
    from climbplan.scan.distances import segment_distances

    starts, ends = points[..., :-1, :], points[..., 1:, :].copy()
    tibia = points[..., -1, :] - points[..., -2, :]
    length = np.maximum(np.linalg.norm(tibia, axis=-1, keepdims=True), 1e-9)
    narrow = points[..., -1, :] - tibia * np.minimum(_NARROW / length, 1.0)
    last = points[..., -1, :] - tibia * np.minimum((2 * scan.flatness + _AT_TOE) / length, 1.0)
    ends[..., -1, :] = narrow
    corners = _near(scan, points, room)
    distance = segment_distances(
        np.ascontiguousarray(starts.reshape(-1, 3)),
        np.ascontiguousarray(ends.reshape(-1, 3)),
        corners,
        room,
    ).reshape(starts.shape[:-1])
    axis = segment_distances(
        np.ascontiguousarray(narrow.reshape(-1, 3)),
        np.ascontiguousarray(last.reshape(-1, 3)),
        corners,
        room,
    ).reshape(narrow.shape[:-1])
    distance[..., -1] = np.minimum(distance[..., -1], np.where(axis > 0, axis + radius, 0.0))
    distance = np.where(np.isnan(points).any(axis=(-2, -1))[..., None], room, distance)
    *index, link = (int(i) for i in np.unravel_index(int(np.argmin(distance)), distance.shape))
    return NearestRaw(float(distance.min()), tuple(index), link)


def raw_body_room(scan: RawSurface, hulls: Array, room: float) -> Array:
    """Distances (...) of body hulls (..., V, 3) from raw triangles, `room` [m] at most.

    Corners and edges of the hull against triangles, and these against the hull's faces: zero where
    they meet.
    """
    from climbplan.scan.distances import segment_distances

    flat = hulls.reshape(-1, *hulls.shape[-2:])
    corners = _near(scan, hulls, room)
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


def _near(scan: RawSurface, points: Array, room: float) -> Array:
    """Triangles whose bounds come within `room` [m] of the bounds of points."""
    flat = points.reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0) - room, np.nanmax(flat, axis=0) + room
    corners = scan.corners
    inside = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return np.ascontiguousarray(corners[inside.all(axis=1)])
