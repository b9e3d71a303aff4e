"""Distances of line segments from convex bodies, each certified by a separating plane."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.convex import ConvexBody

_CONTACT_TOLERANCE = 1e-9  # [m] a corner this close to a face belongs to it
_MIN_LENGTH = 1e-12  # [m] a difference shorter than this has no direction
_CHUNK_SIZE = 4096  # segments at a time
_STRIDES = (64, 16, 4, 1)  # poses of a motion: one of so many that are open is measured, in turn


def measure_chain_distance(points: Array, solid: ConvexBody, sufficient: float) -> Array:
    """Return distances (..., P-1) of the pieces of polylines from a solid, negative where they
    enter it.

    points: (..., P, 3) [m]. A piece that a face of the solid separates from it by `sufficient` [m]
    gets that lower bound instead. Where a piece enters the solid, the value is minus the way out
    across faces and edges.
    """
    distance = solid.separation_by_faces(points)
    is_near = ~(distance >= sufficient)  # NaN stays
    if is_near.any():
        first, last = points[..., :-1, :][is_near], points[..., 1:, :][is_near]
        edges = find_body_edges(solid)
        chunk_gaps = [
            _measure_plane_gaps(
                first[start : start + _CHUNK_SIZE], last[start : start + _CHUNK_SIZE], solid, edges
            )[0]
            for start in range(0, len(first), _CHUNK_SIZE)
        ]
        distance[is_near] = np.maximum(distance[is_near], np.concatenate(chunk_gaps))
    return distance


def measure_motion_distance(segments: Array, solid: ConvexBody, sufficient: float) -> Array:
    """Return distances (P,) of a segment in P poses from a solid: the least one, else lower bounds.

    A plane that separates segment and solid in one pose bounds the distance in its neighbours. Few
    poses are measured at first, then those between them that may be nearer than the nearest so far.

    Args:
        segments: (P, 2, 3) ends of the segment, in order of a motion [m].
        solid: The solid.
        sufficient: A distance of at least this much may be any lower bound of at least it [m].
    """
    bound = solid.separation_by_faces(segments)[:, 0]
    is_measured = np.zeros(len(segments), bool)
    normals, offsets = np.zeros_like(segments[:, 0]), np.full(len(segments), np.inf)
    edges, min_distance = find_body_edges(solid), sufficient
    for stride in _STRIDES:
        open_poses = np.flatnonzero(~(bound >= min_distance) & ~is_measured)  # NaN stays open
        if stride > 1 and len(open_poses) <= stride:
            continue
        chosen = open_poses[::stride]
        for rows in np.array_split(chosen, len(chosen) // _CHUNK_SIZE + 1):
            gap, normals[rows], offsets[rows] = _measure_plane_gaps(
                segments[rows, 0], segments[rows, 1], solid, edges
            )
            bound[rows] = np.maximum(bound[rows], gap)  # NaN stays
        is_measured[chosen] = True
        min_distance = np.fmin(min_distance, bound[chosen].min(initial=np.inf))
        for neighbours in _find_measured_neighbours(is_measured):
            neighbour = neighbours[open_poses]
            ends = segments[open_poses] @ normals[neighbour][:, :, None]  # (P, 2, 1)
            separation = np.minimum(ends[:, 0, 0], ends[:, 1, 0]) - offsets[neighbour]
            bound[open_poses] = np.maximum(bound[open_poses], separation)
    return bound


def _find_measured_neighbours(is_measured: BoolArray) -> tuple[IntArray, IntArray]:
    """Return for each pose (P,) the measured ones before and after it; without one an end pose."""
    poses = np.arange(len(is_measured))
    before = np.maximum.accumulate(np.where(is_measured, poses, 0))
    after = np.minimum.accumulate(np.where(is_measured, poses, len(poses) - 1)[::-1])[::-1]
    return before, after


def find_body_edges(solid: ConvexBody) -> Array:
    """Return the ends (E, 2, 3) of a body's edges: corners that share two faces."""
    size = float(np.abs(solid.corners).max())
    is_on_face = np.abs(solid.face_distances(solid.corners)) < _CONTACT_TOLERANCE * max(1.0, size)
    shared = is_on_face.astype(int) @ is_on_face.T.astype(int)
    first, last = np.nonzero(np.triu(shared >= 2, k=1))
    return np.stack([solid.corners[first], solid.corners[last]], axis=1)


def _measure_plane_gaps(
    first: Array, last: Array, solid: ConvexBody, edges: Array
) -> tuple[Array, Array, Array]:
    """Return the largest gap (S,) that any candidate plane leaves between segment and solid.

    The plane of that gap follows, through the solid: its normal (S, 3) and offset (S,).

    Where they are disjoint, one candidate is perpendicular to the shortest line between them: from
    a face to an end, from an edge to the segment or to an end, from a corner to the segment. The
    gap of any plane is a lower bound on the distance, so that no value is too large.
    """
    segment = (last - first)[:, None]  # (S, 1, 3)
    corners = solid.corners[None]
    start, edge = edges[None, :, 0], edges[None, :, 1] - edges[None, :, 0]
    edge_normals = np.cross(segment, edge)
    ends = (first[:, None], last[:, None])
    to_ends = [end - find_nearest_on_segment(end, start, edge) for end in ends]
    to_segment = find_nearest_on_segment(corners, first[:, None], segment) - corners
    differences = np.concatenate(
        [edge_normals, -edge_normals, *to_ends, to_segment], axis=1
    )  # (S, D, 3)
    length = np.sqrt(np.einsum("sdk,sdk->sd", differences, differences))
    is_degenerate = length < _MIN_LENGTH
    normals = differences / np.where(is_degenerate, 1.0, length)[..., None]
    inner = (normals @ solid.corners.T).max(axis=-1)
    outer = np.minimum(*(np.einsum("sdk,sok->sd", normals, end) for end in ends))
    gaps = np.where(is_degenerate, -np.inf, outer - inner)
    best = gaps.argmax(axis=1)  # NaN counts as the largest
    row = np.arange(len(best))
    return gaps[row, best], normals[row, best], inner[row, best]


def find_nearest_on_segment(point: Array, start: Array, segment: Array) -> Array:
    """Return the nearest points (..., 3) of segments to points, both broadcast."""
    square = np.maximum(np.einsum("...k,...k->...", segment, segment), np.finfo(float).tiny)
    fraction = np.clip(np.einsum("...k,...k->...", point - start, segment) / square, 0.0, 1.0)
    return np.asarray(start + fraction[..., None] * segment)
