"""Batches of triangles: bounds, frames, clipping between heights, and ray casting."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.scan.compiling import compiled


@compiled
def compute_bounding_circles(corners: Array) -> tuple[Array, Array]:
    """Return middles (T, 2) of triangles (T, 3, 3) seen along the normal, and their radii."""
    middle, radius = np.empty((len(corners), 2)), np.empty(len(corners))
    for t in range(len(corners)):
        for k in range(2):
            middle[t, k] = (corners[t, 0, k] + corners[t, 1, k] + corners[t, 2, k]) / 3
        squared_radius = 0.0
        for c in range(3):
            across = corners[t, c, 0] - middle[t, 0]
            along = corners[t, c, 1] - middle[t, 1]
            squared_radius = max(squared_radius, across * across + along * along)
        radius[t] = np.sqrt(squared_radius)
    return middle, radius


@compiled
def find_within_box(corners: Array, lower: Array, upper: Array) -> np.ndarray:
    """Return whether the bounds of triangles meet a box, (T,)."""
    out = np.empty(len(corners), np.bool_)
    for t in range(len(corners)):
        meets = True
        for k in range(3):
            a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
            if min(a, b, c) > upper[k] or max(a, b, c) < lower[k]:
                meets = False
                break
        out[t] = meets
    return out


@compiled
def transform_to_frame(
    corners: Array, number: IntArray, origin: Array, axes: Array
) -> tuple[Array, Array, Array]:
    """Return corners (K, 3, 3) of some triangles in a frame, and their bounds (K, 3).

    The same corner of two triangles has the same digits, unlike in matrix products of different
    lengths: polygons whose edges do not match form no coverage.
    """
    out = np.empty((len(number), 3, 3))
    lowest, highest = np.empty((len(number), 3)), np.empty((len(number), 3))
    for i in range(len(number)):
        t = number[i]
        for k in range(3):
            low, high = np.inf, -np.inf
            for c in range(3):
                value = (corners[t, c, 0] - origin[0]) * axes[k, 0]
                value += (corners[t, c, 1] - origin[1]) * axes[k, 1]
                value += (corners[t, c, 2] - origin[2]) * axes[k, 2]
                out[i, c, k] = value
                low, high = min(low, value), max(high, value)
            lowest[i, k], highest[i, k] = low, high
    return out, lowest, highest


@compiled
def clip_to_heights(corners: Array, low: float, high: float) -> tuple[Array, IntArray]:
    """Clip triangles (T, 3, 3) between two heights; return corners (K, 2) and their counts."""
    points = np.empty((5 * len(corners), 2))
    counts = np.zeros(len(corners), np.int64)
    num_points, num_pieces = 0, 0
    for t in range(len(corners)):
        piece = np.empty((5, 3))
        for c in range(3):
            for j in range(3):
                piece[c, j] = corners[t, c, j]
        size = 3
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            limit = low if side == 0 else -high
            after = np.empty((5, 3))
            count = 0
            for k in range(size):
                start, end = piece[k], piece[(k + 1) % size]
                a, b = sign * start[2] - limit, sign * end[2] - limit
                if a >= 0:
                    for j in range(3):
                        after[count, j] = start[j]
                    count += 1
                if a * b < 0:
                    for j in range(3):
                        after[count, j] = start[j] + a / (a - b) * (end[j] - start[j])
                    count += 1
            piece, size = after, count
        if size >= 3:
            for k in range(size):
                points[num_points + k, 0], points[num_points + k, 1] = piece[k, 0], piece[k, 1]
            num_points += size
            counts[num_pieces] = size
            num_pieces += 1
    return points[:num_points].copy(), counts[:num_pieces].copy()


@compiled
def cast_rays(
    places: Array, direction: Array, corners: Array, far: float
) -> tuple[Array, np.ndarray]:
    """Cast parallel rays; return the distances (P,) [m] and the indices of the first triangles.

    Infinite and -1 without a hit within `far` [m].

    Args:
        places: Starts (P, 3) [m].
        direction: Unit direction (3,).
        corners: Triangles (T, 3, 3) [m].
        far: Length of the rays [m].
    """
    distances = np.full(len(places), np.inf)
    number = np.full(len(places), -1, np.int64)
    for t in range(len(corners)):
        e, f = corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
        # T. Moeller and B. Trumbore (1997)
        px = direction[1] * f[2] - direction[2] * f[1]
        py = direction[2] * f[0] - direction[0] * f[2]
        pz = direction[0] * f[1] - direction[1] * f[0]
        det = e[0] * px + e[1] * py + e[2] * pz
        if abs(det) < 1e-15:
            continue
        for p in range(len(places)):
            s0 = places[p, 0] - corners[t, 0, 0]
            s1 = places[p, 1] - corners[t, 0, 1]
            s2 = places[p, 2] - corners[t, 0, 2]
            u = (s0 * px + s1 * py + s2 * pz) / det
            if u < -1e-9 or u > 1 + 1e-9:
                continue
            qx = s1 * e[2] - s2 * e[1]
            qy = s2 * e[0] - s0 * e[2]
            qz = s0 * e[1] - s1 * e[0]
            v = (direction[0] * qx + direction[1] * qy + direction[2] * qz) / det
            if v < -1e-9 or u + v > 1 + 1e-9:
                continue
            distance = (f[0] * qx + f[1] * qy + f[2] * qz) / det
            if -1e-9 < distance <= far and distance < distances[p]:
                distances[p], number[p] = distance, t
    return distances, number


@compiled
def find_buried(places: Array, directions: Array, corners: Array, far: float) -> np.ndarray:
    """Return whether the first surface that a ray meets within `far` [m] shows its back, (P,)."""
    out = np.zeros(len(places), np.bool_)
    for p in range(len(places)):
        origin, along = places[p], directions[p]
        nearest, back = far, False
        low, high = np.empty(3), np.empty(3)
        for k in range(3):
            end = origin[k] + far * along[k]
            low[k], high[k] = min(origin[k], end), max(origin[k], end)
        for t in range(len(corners)):
            meets = True
            for k in range(3):
                a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
                if min(a, b, c) > high[k] or max(a, b, c) < low[k]:
                    meets = False
                    break
            if not meets:
                continue
            # T. Moeller and B. Trumbore (1997)
            e, f = corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
            px = along[1] * f[2] - along[2] * f[1]
            py = along[2] * f[0] - along[0] * f[2]
            pz = along[0] * f[1] - along[1] * f[0]
            det = e[0] * px + e[1] * py + e[2] * pz
            if abs(det) < 1e-15:
                continue
            s = origin - corners[t, 0]
            u = (s[0] * px + s[1] * py + s[2] * pz) / det
            if u < 0 or u > 1:
                continue
            qx = s[1] * e[2] - s[2] * e[1]
            qy = s[2] * e[0] - s[0] * e[2]
            qz = s[0] * e[1] - s[1] * e[0]
            v = (along[0] * qx + along[1] * qy + along[2] * qz) / det
            if v < 0 or u + v > 1:
                continue
            distance = (f[0] * qx + f[1] * qy + f[2] * qz) / det
            if 0 < distance < nearest:
                nearest, back = distance, det < 0
        out[p] = back
    return out
