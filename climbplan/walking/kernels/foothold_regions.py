"""Selection of terrain regions for footholds, compiled."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task.ground import RegionArrays

_VIOLATION_WEIGHT = 100.0  # distance in metres that a metre of workspace violation is worth
_DEPTH_WEIGHT = 1e-6  # weight of the depth inside, for points in several regions


@compiled
def find_nearest_regions(points: Array, lower: Array, upper: Array, sides: Array) -> IntArray:
    """Return the region (P,) that contains each point (P, 2), or is nearest to it."""
    chosen = np.zeros(points.shape[0], np.int64)
    for p in range(points.shape[0]):
        min_distance = np.inf
        for s in range(lower.shape[0]):
            signed, square = -np.inf, 0.0
            for k in range(2):
                beyond = max(lower[s, k] - points[p, k], points[p, k] - upper[s, k])
                signed = max(signed, beyond)
                square += max(beyond, 0.0) ** 2
            distance = np.sqrt(square)
            for c in range(sides.shape[1]):
                a, b = sides[s, c, 0], sides[s, c, 1]
                signed = max(signed, a * points[p, 0] + b * points[p, 1] - sides[s, c, 2])
            if sides.shape[1]:
                distance = max(distance, signed)
            if distance + _DEPTH_WEIGHT * signed < min_distance:
                min_distance = distance + _DEPTH_WEIGHT * signed
                chosen[p] = s
    return chosen


@compiled
def select_region(
    target: Array, position: Array, R: Array, center: Array, half: Array, footholds: RegionArrays
) -> int:
    """Select the region whose foothold nearest to a target violates a leg's workspace least.

    Among regions without violation it is the nearest one.

    Args:
        target: (2,) horizontal position [m].
        position: (K, 3) of the body while the leg stands [m].
        R: (K, 3, 3) body-to-world rotations.
        center: (3,) of the leg's workspace box, body frame [m].
        half: (3,) half extents of the box [m].
        footholds: S convex regions of admissible footholds.

    Returns:
        Index of the region.
    """
    lower, upper, sides = footholds.lower, footholds.upper, footholds.sides
    height, slope, inner = footholds.height, footholds.slope, footholds.inner
    best, min_cost = 0, np.inf
    spot = np.empty(3)
    for s in range(lower.shape[0]):
        for k in range(2):
            spot[k] = min(max(target[k], lower[s, k]), upper[s, k])
        back = 0.0
        for c in range(sides.shape[1]):  # towards the inner point, up to the furthest side
            a, b, bound = sides[s, c, 0], sides[s, c, 1], sides[s, c, 2]
            past = a * spot[0] + b * spot[1] - bound
            slack = bound - a * inner[s, 0] - b * inner[s, 1]
            if past > 0.0:
                back = max(back, past / max(past + slack, 1e-12))
        spot[2] = height[s]
        for k in range(2):
            spot[k] += back * (inner[s, k] - spot[k])
            spot[2] += slope[s, k] * (spot[k] - inner[s, k])
        cost = np.hypot(spot[0] - target[0], spot[1] - target[1])
        if cost >= min_cost:
            continue
        violation = 0.0
        for n in range(position.shape[0]):
            for i in range(3):
                in_body = 0.0
                for j in range(3):
                    in_body += R[n, j, i] * (spot[j] - position[n, j])
                violation = max(violation, abs(in_body - center[i]) - half[i])
        cost += _VIOLATION_WEIGHT * violation
        if cost < min_cost:
            best, min_cost = s, cost
    return best
