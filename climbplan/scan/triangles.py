"""Many triangles at a time: in boxes and frames, between heights, and met by rays."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.scan.compiling import compiled


@compiled
def circles(corners: Array) -> tuple[Array, Array]:
    """Middles (T, 2) of triangles (T, 3, 3) seen along the normal, and how far corners are off."""
    middle, radius = np.empty((len(corners), 2)), np.empty(len(corners))
    for t in range(len(corners)):
        for k in range(2):
            middle[t, k] = (corners[t, 0, k] + corners[t, 1, k] + corners[t, 2, k]) / 3
        most = 0.0
        for c in range(3):
            across = corners[t, c, 0] - middle[t, 0]
            along = corners[t, c, 1] - middle[t, 1]
            most = max(most, across * across + along * along)
        radius[t] = np.sqrt(most)
    return middle, radius


@compiled
def within_box(corners: Array, lower: Array, upper: Array) -> np.ndarray:
    """(T,) whether the bounds of triangles meet a box."""
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
def in_frame(
    corners: Array, number: IntArray, origin: Array, axes: Array
) -> tuple[Array, Array, Array]:
    """Corners (K, 3, 3) of some triangles in a frame, with their least and largest (K, 3).

    The same corner of two triangles has the same digits, which a product of matrices of different
    lengths does not promise: a coverage whose edges do not match is no coverage.
    """
    out = np.empty((len(number), 3, 3))
    least, most = np.empty((len(number), 3)), np.empty((len(number), 3))
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
            least[i, k], most[i, k] = low, high
    return out, least, most


@compiled
def clipped(corners: Array, low: float, high: float) -> tuple[Array, IntArray]:
    """Corners (K, 2) and their numbers of what of triangles (T, 3, 3) is between two heights."""
    points = np.empty((5 * len(corners), 2))
    counts = np.zeros(len(corners), np.int64)
    used, kept = 0, 0
    for t in range(len(corners)):
        piece = np.empty((5, 3))
        for c in range(3):
            for j in range(3):
                piece[c, j] = corners[t, c, j]
        size = 3
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            least = low if side == 0 else -high
            after = np.empty((5, 3))
            count = 0
            for k in range(size):
                here, there = piece[k], piece[(k + 1) % size]
                a, b = sign * here[2] - least, sign * there[2] - least
                if a >= 0:
                    for j in range(3):
                        after[count, j] = here[j]
                    count += 1
                if a * b < 0:
                    for j in range(3):
                        after[count, j] = here[j] + a / (a - b) * (there[j] - here[j])
                    count += 1
            piece, size = after, count
        if size >= 3:
            for k in range(size):
                points[used + k, 0], points[used + k, 1] = piece[k, 0], piece[k, 1]
            used += size
            counts[kept] = size
            kept += 1
    return points[:used].copy(), counts[:kept].copy()


@compiled
def first_met(
    places: Array, direction: Array, corners: Array, far: float
) -> tuple[Array, np.ndarray]:
    """Ways (P,) [m] from places along a unit direction to the first triangle, and its number.

    Infinite and -1 where none is met within `far` [m].
    """
    ways = np.full(len(places), np.inf)
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
            way = (f[0] * qx + f[1] * qy + f[2] * qz) / det
            if -1e-9 < way <= far and way < ways[p]:
                ways[p], number[p] = way, t
    return ways, number


@compiled
def buried(places: Array, directions: Array, corners: Array, far: float) -> np.ndarray:
    """(P,) whether the first surface that a ray meets within `far` [m] shows its back."""
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
