"""How far apart two books may stand and still touch: closed form and proven bounds.

Book i left of book j is within the contact gap of it exactly if x_j - x_i <= U(alpha_i, alpha_j).
U is the right end of the chord that the ground line cuts from the Minkowski difference of the two
rectangles grown by the gap: the largest among the offset edges, where a corner of one book stands
in front of a face of the other, and the discs about the differences of corners. It is also the
least over all directions, so that any direction gives a bound: the one that U has in the middle of
an angle box is followed over the box, turning with the book if it is a face normal and fixed if it
runs from corner to corner. Notation and means as in `exact_pairs`. Lengths in mm.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.pairs import (
    axis_numbers,
    corner_numbers,
    highest,
    is_steep,
    lowest,
    taylor,
    twist,
)

_TINY = 1e-6  # of a direction's x component, below which it bounds nothing
_ON_FACE = 1e-9  # [mm] a corner this far past a face's end counts as in front of it


@compiled
def contact_end(
    side_i: float,
    width_i: float,
    height_i: float,
    box_i: Array,
    side_j: float,
    width_j: float,
    height_j: float,
    box_j: Array,
    gap: float,
) -> tuple[float, int, float, float]:
    """U in the middle of the boxes; the face normal it has (0, 1 of i, 2, 3 of j) or 4 and the
    direction from corner to corner."""
    end, feature, nx, ny = -np.inf, -1, 1.0, 0.0
    for axis in range(4):
        if axis < 2:
            here = _edge_end(
                axis, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
            )
        else:
            here = _edge_end(
                axis - 2, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
            )
        if here > end:
            end, feature = here, axis
    for v in range(4):
        p, q, u, w = corner_numbers(v, side_i, width_i, height_i)
        x_i = -(p * box_i[2] + q * box_i[3])
        y_i = u * box_i[2] + w * box_i[3]
        for k in range(4):
            p, q, u, w = corner_numbers(k, side_j, width_j, height_j)
            y = u * box_j[2] + w * box_j[3] - y_i
            if abs(y) < gap:
                x = math.sqrt(gap * gap - y * y)
                here = x_i + p * box_j[2] + q * box_j[3] + x
                if here > end + _ON_FACE:
                    end, feature, nx, ny = here, 4, x / gap, y / gap
    return end, feature, nx, ny


@compiled
def _edge_end(
    which: int,
    side: float,
    width: float,
    height: float,
    box: Array,
    other_side: float,
    other_width: float,
    other_height: float,
    other_box: Array,
    gap: float,
) -> float:
    """Largest x_j - x_i with a corner of the other book in front of a face, `gap` away from it."""
    axis = axis_numbers(which, side, width, height, box, gap)
    sec, _, foot, _, _, _ = axis
    if sec[1] > 1e9:
        return -np.inf
    s, c = box[2], box[3]
    # The face's direction away from the foot or from the corner next to it.
    tx, ty, length = (-side * s, c, height) if which == 0 else (side * c, s, width)
    end = -np.inf
    for v in range(4):
        corner = corner_numbers(v, other_side, other_width, other_height)
        p, q, u, w = corner
        x, _, _ = taylor(axis, side, corner, other_box)
        ahead = x - foot[1] - (p * other_box[2] + q * other_box[3])
        along = tx * ahead + ty * (u * other_box[2] + w * other_box[3])
        if -_ON_FACE <= along <= length + _ON_FACE:
            end = max(end, x)
    return end


@compiled
def _turning_ceiling(
    which: int,
    side: float,
    width: float,
    height: float,
    box: Array,
    other_side: float,
    other_width: float,
    other_height: float,
    other_box: Array,
    gap: float,
) -> tuple[float, float, float]:
    """Plane above E + gap / nx of one face normal: E + gap / nx <= p + g da + h db."""
    axis = axis_numbers(which, side, width, height, box, gap)
    sec, tan, foot, face, turn, _ = axis
    r, other_r = box[6], other_box[6]
    low = min(sec[0], sec[2]), min(tan[0], tan[2])
    high = max(sec[0], sec[2]), max(tan[0], tan[2])
    own_bend = face * high[0] * (high[0] * high[0] + high[1] * high[1]) - min(foot[0], foot[2])
    slope = min(turn * tan[0], turn * tan[2])
    corner_00 = corner_01 = corner_10 = corner_11 = -np.inf
    for v in range(4):
        corner = corner_numbers(v, other_side, other_width, other_height)
        p, q, u, w = corner
        value, g, h = taylor(axis, side, corner, other_box)
        bend = own_bend
        if turn > 0:
            bend += 2 * high[1] * high[0] * high[0] * highest(u, w, other_box)
        else:
            bend -= 2 * low[1] * low[0] * low[0] * lowest(u, w, other_box)
        other_bend = -lowest(p + slope * u, q + slope * w, other_box)
        value += 0.5 * (max(0.0, bend) * r * r + max(0.0, other_bend) * other_r * other_r)
        value += twist(axis, corner, r, other_box)
        # The largest of planes is convex: a plane above its corner values is above it.
        corner_00 = max(corner_00, value - g * r - h * other_r)
        corner_01 = max(corner_01, value - g * r + h * other_r)
        corner_10 = max(corner_10, value + g * r - h * other_r)
        corner_11 = max(corner_11, value + g * r + h * other_r)
    g = (corner_10 + corner_11 - corner_00 - corner_01) / (4 * r) if r > 0 else 0.0
    h = (corner_01 + corner_11 - corner_00 - corner_10) / (4 * other_r) if other_r > 0 else 0.0
    plane = max(
        max(corner_00 + g * r + h * other_r, corner_01 + g * r - h * other_r),
        max(corner_10 - g * r + h * other_r, corner_11 - g * r - h * other_r),
    )
    return plane, g, h


@compiled
def _turning_most(
    which: int,
    side: float,
    width: float,
    height: float,
    box: Array,
    other_side: float,
    other_width: float,
    other_height: float,
    other_box: Array,
    gap: float,
) -> float:
    """Constant above E + gap / nx, for normals too near the vertical for planes."""
    sec, tan, foot, face, turn, _ = axis_numbers(which, side, width, height, box, gap)
    # Both are monotone; their sum need not be, as the gap is part of the face's distance.
    own = face * max(sec[0], sec[2]) + max(foot[0], foot[2])
    slope = max(turn * tan[0], turn * tan[2])
    most = -np.inf
    for v in range(4):
        p, q, u, w = corner_numbers(v, other_side, other_width, other_height)
        # Y_v >= 0, so that B_v + T Y_v is largest at the largest T.
        most = max(most, own + highest(p + slope * u, q + slope * w, other_box))
    return most


@compiled
def _reach_ceiling(
    nx: float, ny: float, side: float, width: float, height: float, box: Array
) -> tuple[float, float]:
    """Line above the largest nx X + ny Y of a book's corners over its angle box."""
    r = box[6]
    first = last = -np.inf
    for v in range(4):
        p, q, u, w = corner_numbers(v, side, width, height)
        a, b = ny * u - nx * p, ny * w - nx * q
        value = a * box[2] + b * box[3] + 0.5 * max(0.0, -lowest(a, b, box)) * r * r
        slope = (a * box[3] - b * box[2]) * r
        first, last = max(first, value - slope), max(last, value + slope)
    return 0.5 * (first + last), (0.5 * (last - first) / r if r > 0 else 0.0)


@compiled
def pair_ceiling(
    side_i: float,
    width_i: float,
    height_i: float,
    box_i: Array,
    side_j: float,
    width_j: float,
    height_j: float,
    box_j: Array,
    gap: float,
) -> tuple[float, float, float]:
    """Plane above U for book i left of book j: U <= p + g da_i + h db_j; U itself without width."""
    end, feature, nx, ny = contact_end(
        side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
    )
    if box_i[6] == 0.0 and box_j[6] == 0.0:
        return end, 0.0, 0.0
    most = np.inf
    if feature < 2:
        if not is_steep(axis_numbers(feature, side_i, width_i, height_i, box_i, gap)):
            return _turning_ceiling(
                feature, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
            )
        most = _turning_most(
            feature, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
        )
    elif feature < 4:
        which = feature - 2
        if not is_steep(axis_numbers(which, side_j, width_j, height_j, box_j, gap)):
            p, h, g = _turning_ceiling(
                which, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
            )
            return p, g, h
        most = _turning_most(
            which, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
        )
    # Any direction will do: the horizontal one, or the one from corner to corner.
    p_i, g = _reach_ceiling(1.0, 0.0, side_i, width_i, height_i, box_i)
    p_j, h = _reach_ceiling(1.0, 0.0, -side_j, width_j, height_j, box_j)
    p = p_i + p_j + gap
    if feature == 4 and nx > _TINY:
        p_i, own = _reach_ceiling(nx, ny, side_i, width_i, height_i, box_i)
        p_j, other = _reach_ceiling(nx, -ny, -side_j, width_j, height_j, box_j)
        if p_i + p_j + gap < p * nx:
            p, g, h = (p_i + p_j + gap) / nx, own / nx, other / nx
    if most < p:
        return most, 0.0, 0.0
    return p, g, h
