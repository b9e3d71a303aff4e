"""Signed distances of points from a triangle mesh: negative below the nearest triangle."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from climbplan.arrays import Array, IntArray
from climbplan.motions.tracked_motion import TerrainMesh

FAR = 0.5  # [m] largest distance that is returned; points farther above a mesh have this one
_CHUNK = 256  # points at a time
_MAX_PAIRS = 400_000  # of point and triangle at a time
_SLACK = 1e-9  # [m] for rounding
_MIN_AREA = 1e-14  # [m^2] of a triangle that has a normal


def measure_distances(points: Array, mesh: TerrainMesh) -> Array:
    """Return signed distances (M,) of points (M, 3) from a mesh [m], at most `FAR`.

    A point has a negative distance, however deep it is, where the nearest point of the mesh lies
    inside a triangle and the point is behind that triangle. Behind edges of open surfaces
    distances stay positive.
    """
    corners = mesh.corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    corners = corners[area > _MIN_AREA]
    normal = normal[area > _MIN_AREA] / area[area > _MIN_AREA, None]
    out = np.full(len(points), FAR)
    if not len(corners):
        return out
    low, high = corners.min(axis=1), corners.max(axis=1)
    # No point is farther from the mesh than from a corner or centroid
    centroids = corners.mean(axis=1)
    tree = cKDTree(np.concatenate([corners.reshape(-1, 3), centroids]))
    max_distance, nearest = tree.query(points)
    reach = max_distance + _SLACK
    # Neighbours together: they are near the same few triangles
    order = np.lexsort((max_distance, nearest))
    for start in range(0, len(points), _CHUNK):
        chosen = order[start : start + _CHUNK]
        chunk, margin = points[chosen], reach[chosen].max()
        overlaps = (low <= chunk.max(axis=0) + margin) & (high >= chunk.min(axis=0) - margin)
        candidates = np.flatnonzero(overlaps.all(axis=1))
        rows = max(_MAX_PAIRS // max(len(candidates), 1), 1)
        for first in range(0, len(chunk), rows):
            batch = chosen[first : first + rows]
            out[batch] = _measure_chunk(points[batch], corners, normal, candidates)
    return out


def _measure_chunk(points: Array, corners: Array, normal: Array, candidates: IntArray) -> Array:
    """Return signed distances (M,) from the triangles of indices `candidates`."""
    if not len(candidates):
        return np.full(len(points), FAR)
    triangles, unit = corners[candidates][None], normal[candidates]
    point = points[:, None]
    height = np.einsum("mtk,tk->mt", point - triangles[:, :, 0], unit)
    projection = point - height[..., None] * unit
    edges = np.roll(triangles, -1, axis=2) - triangles
    to_point = projection[:, :, None] - triangles
    inward = np.cross(unit[None, :, None], edges)
    is_inside = ((to_point * inward).sum(axis=-1) >= 0).all(axis=-1)
    square = (edges**2).sum(axis=-1)
    fraction = np.clip((to_point * edges).sum(axis=-1) / square, 0, 1)
    on_edge = triangles + fraction[..., None] * edges
    edge_distance = np.linalg.norm(point[:, :, None] - on_edge, axis=-1).min(axis=-1)
    distance = np.where(is_inside, np.abs(height), edge_distance)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(points))
    is_behind = is_inside[row, nearest] & (height[row, nearest] < 0)
    signed = np.where(is_behind, -distance[row, nearest], distance[row, nearest])
    return np.minimum(signed, FAR)
