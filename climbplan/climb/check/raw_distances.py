"""Distances of segments from raw triangles, as the checks measure them: by planes between them."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray

_NO_DIRECTION = 1e-12  # [m] a difference shorter than this has no direction
_SOME = 2_000  # segments at a time
_CHUNK = 200_000  # pairs of segment and triangle at a time


def meeting(corners: Array, lower: Array, upper: Array) -> IntArray:
    """Numbers of triangles whose bounds meet a box."""
    inside = (corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)
    return np.asarray(np.flatnonzero(inside.all(axis=1)), np.int64)


def distances(starts: Array, ends: Array, corners: Array, enough: float) -> Array:
    """Distances (S,) of segments (S, 3) from the nearest triangle, `enough` [m] at most.

    Negative or zero where a segment meets one. NaN stays.
    """
    low, high = np.minimum(starts, ends) - enough, np.maximum(starts, ends) + enough
    out = np.where(np.isfinite(low).all(axis=1), enough, np.nan)
    if not len(starts):
        return out
    # A few at a time: in the order of motion these are near each other, and near few triangles
    for at in range(0, len(starts), _SOME):
        part = slice(at, at + _SOME)
        if np.isnan(low[part]).all():
            continue
        some = meeting(corners, np.nanmin(low[part], axis=0), np.nanmax(high[part], axis=0))
        least, most = corners[some].min(axis=1), corners[some].max(axis=1)
        near = (least[None] <= high[part, None]).all(axis=-1)
        near &= (most[None] >= low[part, None]).all(axis=-1)
        row, triangle = np.nonzero(near)
        for first in range(0, len(row), _CHUNK):
            rows, chosen = row[first : first + _CHUNK] + at, triangle[first : first + _CHUNK]
            apart = gaps(starts[rows], ends[rows], corners[some[chosen]])
            np.minimum.at(out, rows, apart)
    return out


def gaps(first: Array, last: Array, corners: Array) -> Array:
    """The widest gap (S,) that a plane leaves between segments (S, 3) and triangles (S, 3, 3).

    One of the candidates is perpendicular to the shortest way between them: the triangle's face,
    an edge and the segment, an end and an edge, a corner and the segment. No value is too large.
    """
    along = (last - first)[:, None]
    edges = np.roll(corners, -1, axis=1) - corners
    face = np.cross(edges[:, :1], -edges[:, 2:])
    crossed = np.cross(along, edges)
    to_ends = [end[:, None] - _nearest(end[:, None], corners, edges) for end in (first, last)]
    to_corners = _nearest(corners, first[:, None], along) - corners
    differences = np.concatenate([face, -face, crossed, -crossed, *to_ends, to_corners], axis=1)
    length = np.sqrt((differences**2).sum(axis=-1))
    short = length < _NO_DIRECTION
    normals = differences / np.where(short, 1.0, length)[..., None]
    inner = np.einsum("sdk,sck->sdc", normals, corners).max(axis=-1)
    outer = np.minimum(*((normals * end[:, None]).sum(axis=-1) for end in (first, last)))
    gap: Array = np.where(short, -np.inf, outer - inner).max(axis=1)
    return gap


def _nearest(point: Array, start: Array, along: Array) -> Array:
    """Nearest points (..., 3) of segments to points, both broadcast."""
    square = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip(((point - start) * along).sum(axis=-1) / square, 0.0, 1.0)
    return np.asarray(start + share[..., None] * along)


def nearest_on(corners: Array, point: Array) -> Array:
    """(T, 3) the place of each triangle that is nearest to a point."""
    edges = np.roll(corners, -1, axis=1) - corners
    on_edges = _nearest(np.broadcast_to(point, corners.shape), corners, edges)
    nearest = np.linalg.norm(on_edges - point, axis=-1).argmin(axis=1)
    found = on_edges[np.arange(len(corners)), nearest]
    up = np.cross(edges[:, 0], edges[:, 1])
    square = np.maximum((up**2).sum(axis=1), np.finfo(float).tiny)
    foot = point - (((point - corners[:, 0]) * up).sum(axis=1) / square)[:, None] * up
    inward = np.cross(up[:, None], edges)
    within = (((foot[:, None] - corners) * inward).sum(axis=-1) >= 0).all(axis=1)
    return np.where(within[:, None], foot, found)
