"""Which region a toe would best stand on, compiled: what gaits on rough ground ask for most."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.walking.kernels.compiling import compiled

_BEYOND = 100.0  # metres from the middle of its box that a metre outside is worth
_DEEP = 1e-6  # of two regions that hold a point the one further inside


@compiled
def nearest_regions(points: Array, lower: Array, upper: Array, sides: Array) -> IntArray:
    """The region (P,) that each point (P, 2) is in, or least far from; as `Ground.nearest`."""
    chosen = np.zeros(points.shape[0], np.int64)
    for p in range(points.shape[0]):
        least = np.inf
        for s in range(lower.shape[0]):
            deep, square = -np.inf, 0.0
            for k in range(2):
                beyond = max(lower[s, k] - points[p, k], points[p, k] - upper[s, k])
                deep = max(deep, beyond)
                square += max(beyond, 0.0) ** 2
            apart = np.sqrt(square)
            for c in range(sides.shape[1]):
                a, b = sides[s, c, 0], sides[s, c, 1]
                deep = max(deep, a * points[p, 0] + b * points[p, 1] - sides[s, c, 2])
            if sides.shape[1]:
                apart = max(apart, deep)
            if apart + _DEEP * deep < least:
                least = apart + _DEEP * deep
                chosen[p] = s
    return chosen


@compiled
def best_region(
    wanted: Array,
    position: Array,
    R: Array,
    center: Array,
    half: Array,
    lower: Array,
    upper: Array,
    sides: Array,
    height: Array,
    slope: Array,
    inner: Array,
) -> int:
    """The region whose foothold nearest to a point (2,) leaves a leg's box least.

    position (K, 3) and R (K, 3, 3): of the body while the leg stands; center, half (3,): its box;
    lower, upper, sides: of footholds. Of several that do not leave it the nearest to the point.
    """
    best, least = 0, np.inf
    spot = np.empty(3)
    for s in range(lower.shape[0]):
        for k in range(2):
            spot[k] = min(max(wanted[k], lower[s, k]), upper[s, k])
        back = 0.0
        for c in range(sides.shape[1]):  # towards the middle, up to the furthest side
            a, b, bound = sides[s, c, 0], sides[s, c, 1], sides[s, c, 2]
            past = a * spot[0] + b * spot[1] - bound
            room = bound - a * inner[s, 0] - b * inner[s, 1]
            if past > 0.0:
                back = max(back, past / max(past + room, 1e-12))
        spot[2] = height[s]
        for k in range(2):
            spot[k] += back * (inner[s, k] - spot[k])
            spot[2] += slope[s, k] * (spot[k] - inner[s, k])
        price = np.hypot(spot[0] - wanted[0], spot[1] - wanted[1])
        if price >= least:
            continue
        beyond = 0.0
        for n in range(position.shape[0]):
            for i in range(3):
                seen = 0.0
                for j in range(3):
                    seen += R[n, j, i] * (spot[j] - position[n, j])
                beyond = max(beyond, abs(seen - center[i]) - half[i])
        price += _BEYOND * beyond
        if price < least:
            best, least = s, price
    return best
