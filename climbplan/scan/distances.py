"""Distances of segments (links, swing paths of toes) from the triangles of a raw surface."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.scan.compiling import compiled


@compiled
def _find_nearest_point(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the point of a triangle nearest to a point (C. Ericson, 2004, section 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1 = ab[0] * ap[0] + ab[1] * ap[1] + ab[2] * ap[2]
    d2 = ac[0] * ap[0] + ac[1] * ap[1] + ac[2] * ap[2]
    v, w = 0.0, 0.0
    bp = p - b
    d3 = ab[0] * bp[0] + ab[1] * bp[1] + ab[2] * bp[2]
    d4 = ac[0] * bp[0] + ac[1] * bp[1] + ac[2] * bp[2]
    cp = p - c
    d5 = ab[0] * cp[0] + ab[1] * cp[1] + ab[2] * cp[2]
    d6 = ac[0] * cp[0] + ac[1] * cp[1] + ac[2] * cp[2]
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        v, w = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    return a + v * ab + w * ac


@compiled
def _compute_point_distance(p: Array, a: Array, b: Array, c: Array) -> float:
    """Return the squared distance of a point from a triangle."""
    off = p - _find_nearest_point(p, a, b, c)
    return float(off[0] * off[0] + off[1] * off[1] + off[2] * off[2])


@compiled
def _compute_segment_distance(p: Array, q: Array, r: Array, s: Array) -> float:
    """Return the squared distance of two segments p q and r s."""
    u, v, w = q - p, s - r, p - r
    a = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    e = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    b = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    c = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
    f = v[0] * w[0] + v[1] * w[1] + v[2] * w[2]
    det = a * e - b * b
    x = 0.0
    if det > 1e-14 * max(a * e, 1e-300):
        x = min(max((b * f - c * e) / det, 0.0), 1.0)
    y = (b * x + f) / e if e > 1e-300 else 0.0
    if y < 0:
        y = 0.0
        x = min(max(-c / a, 0.0), 1.0) if a > 1e-300 else 0.0
    elif y > 1:
        y = 1.0
        x = min(max((b - c) / a, 0.0), 1.0) if a > 1e-300 else 0.0
    out = 0.0
    for k in range(3):
        out += (w[k] + x * u[k] - y * v[k]) ** 2
    return out


@compiled
def _crosses(p: Array, q: Array, a: Array, b: Array, c: Array) -> bool:
    """Return whether a segment passes through a triangle."""
    along = q - p
    e, f, s = b - a, c - a, p - a
    px = along[1] * f[2] - along[2] * f[1]
    py = along[2] * f[0] - along[0] * f[2]
    pz = along[0] * f[1] - along[1] * f[0]
    det = e[0] * px + e[1] * py + e[2] * pz
    if abs(det) < 1e-18:
        return False
    u = (s[0] * px + s[1] * py + s[2] * pz) / det
    if u < 0 or u > 1:
        return False
    qx = s[1] * e[2] - s[2] * e[1]
    qy = s[2] * e[0] - s[0] * e[2]
    qz = s[0] * e[1] - s[1] * e[0]
    v = (along[0] * qx + along[1] * qy + along[2] * qz) / det
    if v < 0 or u + v > 1:
        return False
    t = (f[0] * qx + f[1] * qy + f[2] * qz) / det
    return 0 <= t <= 1


@compiled
def _compute_triangle_distance(p: Array, q: Array, x: Array, y: Array, z: Array) -> float:
    """Return the squared distance of a segment from a triangle that it does not pass through."""
    away = min(
        _compute_segment_distance(p, q, x, y),
        _compute_segment_distance(p, q, y, z),
        _compute_segment_distance(p, q, z, x),
    )
    return float(
        min(away, _compute_point_distance(p, x, y, z), _compute_point_distance(q, x, y, z))
    )


@compiled
def _compute_boxes(corners: Array) -> tuple[Array, Array]:
    """Return the lowest and highest corners (T, 3) of boxes around triangles (T, 3, 3)."""
    low, high = np.empty((len(corners), 3)), np.empty((len(corners), 3))
    for t in range(len(corners)):
        for k in range(3):
            a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
            low[t, k], high[t, k] = min(a, b, c), max(a, b, c)
    return low, high


@compiled
def _bound_distance(p: Array, q: Array, low: Array, high: Array) -> float:
    """Return a lower bound of the squared distance: that of a box from the box around a segment."""
    gap = 0.0
    for k in range(3):
        a, b = min(p[k], q[k]), max(p[k], q[k])
        apart = max(low[k] - b, a - high[k])
        if apart > 0:
            gap += apart * apart
    return gap


@compiled
def find_nearest_triangles(
    starts: Array, ends: Array, corners: Array, max_distance: float
) -> tuple[Array, IntArray]:
    """Return the smallest distances (S,) of segments from triangles, and which are nearest (S,).

    A distance is zero where a segment passes through a triangle.

    Args:
        starts: (S, 3) [m].
        ends: (S, 3) [m].
        corners: Triangles (T, 3, 3) [m].
        max_distance: Distance [m] that is returned, with no triangle (-1), if all are farther.
    """
    out = np.full(len(starts), max_distance)
    nearest = np.full(len(starts), -1, np.int64)
    low, high = _compute_boxes(corners)
    for i in range(len(starts)):
        p, q = starts[i], ends[i]
        best = max_distance * max_distance
        for t in range(len(corners)):
            gap = _bound_distance(p, q, low[t], high[t])
            if gap >= best:
                continue
            x, y, z = corners[t, 0], corners[t, 1], corners[t, 2]
            if _crosses(p, q, x, y, z):
                best, nearest[i] = 0.0, t
                break
            away = _compute_triangle_distance(p, q, x, y, z)
            if away < best:
                best, nearest[i] = away, t
        out[i] = np.sqrt(best)
    return out, nearest


def compute_triangle_distances(
    starts: Array, ends: Array, corners: Array, max_distance: float
) -> Array:
    """Return the distances of `nearest_triangles`, for arrays of any layout."""
    # Read-only arrays would be compiled separately
    starts, ends, corners = (np.require(a, float, ["C", "W"]) for a in (starts, ends, corners))
    return find_nearest_triangles(starts, ends, corners, max_distance)[0]


@compiled
def find_contact_surfaces(
    places: Array, normals: Array, corners: Array, facing: float, rising: float, slack: float
) -> BoolArray:
    """Return the triangles (T, 3, 3) of the surface that each contact is on, (C, T).

    Args:
        places: Contacts (C, 3) [m].
        normals: Unit normals (C, 3).
        corners: Triangles [m].
        facing: Smallest cosine between normals.
        rising: Tangent of the slope by which a triangle's nearest point may rise above its plane.
        slack: Height in addition to that [m].
    """
    out = np.zeros((len(places), len(corners)), np.bool_)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        e, f = b - a, c - a
        nx = e[1] * f[2] - e[2] * f[1]
        ny = e[2] * f[0] - e[0] * f[2]
        nz = e[0] * f[1] - e[1] * f[0]
        size = np.sqrt(nx * nx + ny * ny + nz * nz)
        for i in range(len(places)):
            n = normals[i]
            if nx * n[0] + ny * n[1] + nz * n[2] < facing * size:
                continue
            offset = _find_nearest_point(places[i], a, b, c) - places[i]
            height = offset[0] * n[0] + offset[1] * n[1] + offset[2] * n[2]
            square = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
            lateral = np.sqrt(max(square - height * height, 0.0))
            out[i, t] = height <= slack + rising * lateral
    return out


@compiled
def compute_missing_clearance(
    starts: Array,
    ends: Array,
    need: Array,
    contact: IntArray,
    on_surface: BoolArray,
    corners: Array,
    max_missing: float,
) -> tuple[Array, IntArray]:
    """Return by how much segments (S, 3) come too close to triangles (T, 3, 3), and to which, (S,).

    Zero and -1 where nothing is missing.

    Args:
        starts: (S, 3) [m].
        ends: (S, 3) [m].
        need: Clearances (S, 1 + C) from triangles in general, then from those of each contact [m];
            negative for none.
        contact: Rows (S, C) of `on_surface`, -1 for none.
        on_surface: (U, T) triangles of the surface of each contact.
        corners: Triangles (T, 3, 3) [m].
        max_missing: Result where a segment passes through a triangle [m].
    """
    short = np.zeros(len(starts))
    nearest = np.full(len(starts), -1, np.int64)
    low, high = _compute_boxes(corners)
    for i in range(len(starts)):
        p, q = starts[i], ends[i]
        if np.isnan(p).any() or np.isnan(q).any():
            continue
        widest = need[i, 0]
        for j in range(contact.shape[1]):
            widest = max(widest, need[i, 1 + j])
        for t in range(len(corners)):
            gap = _bound_distance(p, q, low[t], high[t])
            if widest < 0 or gap > widest * widest:
                continue
            required = need[i, 0]
            for j in range(contact.shape[1]):
                if contact[i, j] >= 0 and on_surface[contact[i, j], t]:
                    required = min(required, need[i, 1 + j])
            if required < 0 or gap > (required - short[i]) ** 2:
                continue
            x, y, z = corners[t, 0], corners[t, 1], corners[t, 2]
            if _crosses(p, q, x, y, z):
                short[i], nearest[i] = max_missing, t
                break
            away = _compute_triangle_distance(p, q, x, y, z)
            missing = required - np.sqrt(away)
            if missing > short[i]:
                short[i], nearest[i] = missing, t
    return short, nearest
