"""Distances of segments from raw triangles, by separating planes."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray

_MIN_LENGTH = 1e-12  # [m] a difference shorter than this has no direction
_SEGMENT_CHUNK = 2_000  # segments at a time
_PAIR_CHUNK = 200_000  # pairs of segment and triangle at a time


def _find_overlapping_triangles(corners: Array, lower: Array, upper: Array) -> IntArray:
    """Return the indices of triangles whose bounding boxes overlap a box."""
    inside = (corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)
    return np.asarray(np.flatnonzero(inside.all(axis=1)), np.int64)


def measure_triangle_distances(
    starts: Array, ends: Array, corners: Array, sufficient: float
) -> Array:
    """Return distances (S,) of segments (S, 3) from the nearest triangle, at most `sufficient` [m].

    Values are negative or zero where a segment intersects a triangle. NaN stays.
    """
    low, high = np.minimum(starts, ends) - sufficient, np.maximum(starts, ends) + sufficient
    nearest_distance = np.where(np.isfinite(low).all(axis=1), sufficient, np.nan)
    if not len(starts):
        return nearest_distance
    # A few at a time: in the order of motion these are near each other, and near few triangles
    for start in range(0, len(starts), _SEGMENT_CHUNK):
        chunk = slice(start, start + _SEGMENT_CHUNK)
        if np.isnan(low[chunk]).all():
            continue
        candidates = _find_overlapping_triangles(
            corners, np.nanmin(low[chunk], axis=0), np.nanmax(high[chunk], axis=0)
        )
        triangle_min, triangle_max = (
            corners[candidates].min(axis=1),
            corners[candidates].max(axis=1),
        )
        is_near = (triangle_min[None] <= high[chunk, None]).all(axis=-1)
        is_near &= (triangle_max[None] >= low[chunk, None]).all(axis=-1)
        row, triangle = np.nonzero(is_near)
        for first in range(0, len(row), _PAIR_CHUNK):
            rows, pair_triangles = (
                row[first : first + _PAIR_CHUNK] + start,
                triangle[first : first + _PAIR_CHUNK],
            )
            pair_gaps = measure_plane_gaps(
                starts[rows], ends[rows], corners[candidates[pair_triangles]]
            )
            np.minimum.at(nearest_distance, rows, pair_gaps)
    return nearest_distance


def measure_plane_gaps(first: Array, last: Array, corners: Array) -> Array:
    """Return the widest gap (S,) that a plane leaves between segments (S, 3) and triangles (S, 3,
    3).

    One candidate is perpendicular to the shortest line between them: the triangle's face, an edge
    and the segment, an end and an edge, a corner and the segment. No value is too large.
    """
    segment = (last - first)[:, None]
    edges = np.roll(corners, -1, axis=1) - corners
    face = np.cross(edges[:, :1], -edges[:, 2:])
    edge_normals = np.cross(segment, edges)
    to_ends = [
        end[:, None] - _find_nearest_on_segment(end[:, None], corners, edges)
        for end in (first, last)
    ]
    to_corners = _find_nearest_on_segment(corners, first[:, None], segment) - corners
    differences = np.concatenate(
        [face, -face, edge_normals, -edge_normals, *to_ends, to_corners], axis=1
    )
    length = np.sqrt((differences**2).sum(axis=-1))
    is_degenerate = length < _MIN_LENGTH
    normals = differences / np.where(is_degenerate, 1.0, length)[..., None]
    inner = np.einsum("sdk,sck->sdc", normals, corners).max(axis=-1)
    outer = np.minimum(*((normals * end[:, None]).sum(axis=-1) for end in (first, last)))
    gap: Array = np.where(is_degenerate, -np.inf, outer - inner).max(axis=1)
    return gap


def _find_nearest_on_segment(point: Array, start: Array, segment: Array) -> Array:
    """Return the nearest points (..., 3) of segments to points, both broadcast."""
    square = np.maximum((segment**2).sum(axis=-1), np.finfo(float).tiny)
    fraction = np.clip(((point - start) * segment).sum(axis=-1) / square, 0.0, 1.0)
    return np.asarray(start + fraction[..., None] * segment)


def find_nearest_on_triangles(corners: Array, point: Array) -> Array:
    """Return the point (T, 3) of each triangle that is nearest to a point."""
    edges = np.roll(corners, -1, axis=1) - corners
    on_edges = _find_nearest_on_segment(np.broadcast_to(point, corners.shape), corners, edges)
    nearest = np.linalg.norm(on_edges - point, axis=-1).argmin(axis=1)
    nearest_edge_point = on_edges[np.arange(len(corners)), nearest]
    face_normal = np.cross(edges[:, 0], edges[:, 1])
    square = np.maximum((face_normal**2).sum(axis=1), np.finfo(float).tiny)
    projection = (
        point
        - (((point - corners[:, 0]) * face_normal).sum(axis=1) / square)[:, None] * face_normal
    )
    inward = np.cross(face_normal[:, None], edges)
    is_inside = (((projection[:, None] - corners) * inward).sum(axis=-1) >= 0).all(axis=1)
    return np.where(is_inside[:, None], projection, nearest_edge_point)
