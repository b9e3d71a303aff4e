"""Terrain swept by swinging toes, compiled: the heights that they have to clear."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.compiling import compiled
from climbplan.walking.task.ground import RegionArrays
from climbplan.walking.task.height_grid import HeightGrid

_NOTHING = -1e30
_TOUCHES = 1e-9  # [m], and of a path: terrain at its ends counts despite rounding


@compiled
def find_highest_cell(start: Array, end_point: Array, grid: HeightGrid) -> float:
    """Return the highest cell of a grid beneath the straight path between two points (2,) [m].

    Cells bound the surface of those around them, so that points half a cell apart miss none.
    """
    highest = _NOTHING
    if grid.height.shape[0] == 0:
        return highest
    length = np.hypot(end_point[0] - start[0], end_point[1] - start[1])
    count = int(np.ceil(2.0 * length / grid.cell)) + 1
    for k in range(count + 1):
        fraction = k / count
        x = start[0] + fraction * (end_point[0] - start[0]) - grid.origin[0]
        y = start[1] + fraction * (end_point[1] - start[1]) - grid.origin[1]
        i, j = int(np.floor(x / grid.cell)), int(np.floor(y / grid.cell))
        if 0 <= i < grid.height.shape[0] and 0 <= j < grid.height.shape[1]:
            highest = max(highest, grid.height[i, j])
    return highest


@compiled
def find_highest_terrain(start: Array, end_point: Array, terrain: RegionArrays) -> float:
    """Return the highest terrain beneath the straight path between two points (2,) [m].

    It is far below everything where there is no terrain. Of a scan it is an upper bound.
    """
    highest = find_highest_cell(start, end_point, terrain.grid)
    lower, upper, sides = terrain.lower, terrain.upper, terrain.sides
    height, slope, inner = terrain.height, terrain.slope, terrain.inner
    for s in range(height.shape[0]):
        begin, end = 0.0, 1.0
        for k in range(2):
            step = end_point[k] - start[k]
            for sign, bound in ((-1.0, -lower[s, k]), (1.0, upper[s, k])):
                distance = bound - sign * start[k]
                rate = sign * step
                if abs(rate) < 1e-12:
                    if distance < -_TOUCHES:
                        end = -1.0
                elif rate > 0.0:
                    end = min(end, distance / rate)
                else:
                    begin = max(begin, distance / rate)
        for c in range(sides.shape[1]):
            a, b = sides[s, c, 0], sides[s, c, 1]
            distance = sides[s, c, 2] - a * start[0] - b * start[1]
            rate = a * (end_point[0] - start[0]) + b * (end_point[1] - start[1])
            if abs(rate) < 1e-12:
                if distance < -_TOUCHES:
                    end = -1.0
            elif rate > 0.0:
                end = min(end, distance / rate)
            else:
                begin = max(begin, distance / rate)
        if begin > end + _TOUCHES:
            continue
        for fraction in (begin, end):
            level = height[s]
            for k in range(2):
                level += slope[s, k] * (
                    start[k] + fraction * (end_point[k] - start[k]) - inner[s, k]
                )
            highest = max(highest, level)
    return highest


@compiled
def compute_swing_heights(
    toes: Array, contact: BoolArray, region: IntArray, terrain: RegionArrays
) -> Array:
    """Return the terrain height that swinging toes have to clear at each knot.

    It is the highest terrain beneath the paths from the previous knot and to the next, and at the
    landing: the toe rises where it stood, moves level, and descends where it will stand.

    Args:
        toes: (N + 1, L, 3) world frame [m].
        contact: (N + 1, L).
        region: (N + 1, L) where toes stand, or will stand.
        terrain: S convex regions.

    Returns:
        Heights (N + 1, L); those of standing toes are their own [m].
    """
    lower, upper, height = terrain.lower, terrain.upper, terrain.height
    slope, inner = terrain.slope, terrain.inner
    knots, legs = contact.shape
    clear = np.empty((knots, legs))
    for leg in range(legs):
        for n in range(knots):
            clear[n, leg] = toes[n, leg, 2]
            if contact[n, leg] or n == 0:
                continue
            lands = n
            while lands < knots and not contact[lands, leg]:
                lands += 1
            if lands < knots:
                needed = toes[lands, leg, 2]
            else:  # beyond the horizon: the region that it moves to
                s = region[knots - 1, leg]
                needed = height[s]
                for k in range(2):
                    landing = min(max(toes[n, leg, k], lower[s, k]), upper[s, k])
                    needed += slope[s, k] * (landing - inner[s, k])
            for m in (n - 1, n + 1):
                if m < knots:
                    swept = find_highest_terrain(toes[n, leg, :2], toes[m, leg, :2], terrain)
                    needed = max(needed, swept)
            clear[n, leg] = needed
    return clear
