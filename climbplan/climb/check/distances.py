"""Distances of line segments from convex bodies, each certified by a plane that parts them."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.convex import ConvexBody

_TOUCHING = 1e-9  # [m] a corner this close to a face belongs to it
_NO_DIRECTION = 1e-12  # [m] a difference shorter than this has no direction
_CHUNK = 4096  # segments at a time


def chain_distance(points: Array, solid: ConvexBody, enough: float) -> Array:
    """Distances (..., P-1) of the pieces of polylines from a solid, negative where they meet it.

    points: (..., P, 3) [m]. A piece that a face of the solid parts from it by `enough` [m] gets
    that lower bound instead. Where a piece meets the solid, the value is minus the way out across
    faces and edges.
    """
    distance = solid.separation_by_faces(points)
    near = ~(distance >= enough)  # NaN stays
    if near.any():
        first, last = points[..., :-1, :][near], points[..., 1:, :][near]
        edges = body_edges(solid)
        found = [
            _parted_by(first[at : at + _CHUNK], last[at : at + _CHUNK], solid, edges)
            for at in range(0, len(first), _CHUNK)
        ]
        distance[near] = np.maximum(distance[near], np.concatenate(found))
    return distance


def body_edges(solid: ConvexBody) -> Array:
    """Ends (E, 2, 3) of a body's edges: corners that share two faces."""
    size = float(np.abs(solid.corners).max())
    on = np.abs(solid.face_distances(solid.corners)) < _TOUCHING * max(1.0, size)
    shared = on.astype(int) @ on.T.astype(int)
    first, last = np.nonzero(np.triu(shared >= 2, k=1))
    return np.stack([solid.corners[first], solid.corners[last]], axis=1)


def _parted_by(first: Array, last: Array, solid: ConvexBody, edges: Array) -> Array:
    """Largest gap (S,) that any plane of the candidates leaves between segment and solid.

    Where they are apart, one of the candidates is perpendicular to the shortest way between them:
    a face to an end, an edge to the segment's inside or to an end, a corner to the segment. A
    plane leaves no more room than there is, whatever its direction, so no value is too large.
    """
    along = (last - first)[:, None]  # (S, 1, 3)
    corners = solid.corners[None]
    start, edge = edges[None, :, 0], edges[None, :, 1] - edges[None, :, 0]
    crossed = np.cross(along, edge)
    ends = (first[:, None], last[:, None])
    to_ends = [end - nearest_on(end, start, edge) for end in ends]
    to_segment = nearest_on(corners, first[:, None], along) - corners
    differences = np.concatenate([crossed, -crossed, *to_ends, to_segment], axis=1)  # (S, D, 3)
    length = np.sqrt(np.einsum("sdk,sdk->sd", differences, differences))
    short = length < _NO_DIRECTION
    normals = differences / np.where(short, 1.0, length)[..., None]
    inner = (normals @ solid.corners.T).max(axis=-1)
    outer = np.minimum(*(np.einsum("sdk,sok->sd", normals, end) for end in ends))
    gap: Array = np.where(short, -np.inf, outer - inner).max(axis=1)
    return gap


def nearest_on(point: Array, start: Array, along: Array) -> Array:
    """Nearest points (..., 3) of segments to points, both broadcast."""
    square = np.maximum(np.einsum("...k,...k->...", along, along), np.finfo(float).tiny)
    share = np.clip(np.einsum("...k,...k->...", point - start, along) / square, 0.0, 1.0)
    return np.asarray(start + share[..., None] * along)
