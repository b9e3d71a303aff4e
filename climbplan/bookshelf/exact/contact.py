"""Largest distance at which two books touch: closed form and proven upper bounds.

Book i left of book j is within the contact gap of it exactly if x_j - x_i <= U(alpha_i, alpha_j).
U is the right end of the chord that the ground line cuts from the Minkowski difference of the two
rectangles grown by the gap: the largest among the offset edges, where a corner of one book stands
in front of a face of the other, and the discs about the differences of corners. It is also the
least over all directions, so that any direction gives a bound: the one that U has in the middle of
an angle box is followed over the box, turning with the book if it is a face normal and fixed if it
runs from corner to corner. Notation and methods are those of `pairs`. Lengths in mm.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.compiling import compiled
from climbplan.bookshelf.exact.pairs import (
    bound_mixed_term,
    compute_axis_terms,
    compute_corner_terms,
    expand_taylor,
    is_near_vertical,
    maximise_sinusoid,
    minimise_sinusoid,
)

_TINY = 1e-6  # of a direction's x component, below which it bounds nothing
_ON_FACE = 1e-9  # [mm] a corner this far past a face's end counts as in front of it


@compiled
def compute_contact_distance(
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
    """Compute U in the middle of the boxes.

    Returns U, the face normal that gives it (0, 1 of i, 2, 3 of j; 4 for two corners), and the
    direction from corner to corner.
    """
    end, feature, nx, ny = -np.inf, -1, 1.0, 0.0
    for axis in range(4):
        if axis < 2:
            candidate = _compute_edge_contact(
                axis, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
            )
        else:
            candidate = _compute_edge_contact(
                axis - 2, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
            )
        if candidate > end:
            end, feature = candidate, axis
    for v in range(4):
        p, q, u, w = compute_corner_terms(v, side_i, width_i, height_i)
        x_i = -(p * box_i[2] + q * box_i[3])
        y_i = u * box_i[2] + w * box_i[3]
        for k in range(4):
            p, q, u, w = compute_corner_terms(k, side_j, width_j, height_j)
            y = u * box_j[2] + w * box_j[3] - y_i
            if abs(y) < gap:
                x = math.sqrt(gap * gap - y * y)
                candidate = x_i + p * box_j[2] + q * box_j[3] + x
                if candidate > end + _ON_FACE:
                    end, feature, nx, ny = candidate, 4, x / gap, y / gap
    return end, feature, nx, ny


@compiled
def _compute_edge_contact(
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
    """Compute the largest x_j - x_i with a corner of the other book `gap` in front of a face."""
    axis = compute_axis_terms(which, side, width, height, box, gap)
    sec, _, foot, _, _, _ = axis
    if sec[1] > 1e9:
        return -np.inf
    s, c = box[2], box[3]
    # The face's direction away from the foot or from the corner next to it.
    tx, ty, length = (-side * s, c, height) if which == 0 else (side * c, s, width)
    end = -np.inf
    for v in range(4):
        corner = compute_corner_terms(v, other_side, other_width, other_height)
        p, q, u, w = corner
        x, _, _ = expand_taylor(axis, side, corner, other_box)
        ahead = x - foot[1] - (p * other_box[2] + q * other_box[3])
        along = tx * ahead + ty * (u * other_box[2] + w * other_box[3])
        if -_ON_FACE <= along <= length + _ON_FACE:
            end = max(end, x)
    return end


@compiled
def _bound_turning_normal(
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
    """Bound E + gap / nx of one face normal by a plane above it: p + g da + h db."""
    axis = compute_axis_terms(which, side, width, height, box, gap)
    sec, tan, foot, face, turn, _ = axis
    r, other_r = box[6], other_box[6]
    low = min(sec[0], sec[2]), min(tan[0], tan[2])
    high = max(sec[0], sec[2]), max(tan[0], tan[2])
    face_curvature = face * high[0] * (high[0] * high[0] + high[1] * high[1]) - min(
        foot[0], foot[2]
    )
    slope = min(turn * tan[0], turn * tan[2])
    corner_00 = corner_01 = corner_10 = corner_11 = -np.inf
    for v in range(4):
        corner = compute_corner_terms(v, other_side, other_width, other_height)
        p, q, u, w = corner
        value, g, h = expand_taylor(axis, side, corner, other_box)
        curvature = face_curvature
        if turn > 0:
            curvature += 2 * high[1] * high[0] * high[0] * maximise_sinusoid(u, w, other_box)
        else:
            curvature -= 2 * low[1] * low[0] * low[0] * minimise_sinusoid(u, w, other_box)
        other_curvature = -minimise_sinusoid(p + slope * u, q + slope * w, other_box)
        value += 0.5 * (max(0.0, curvature) * r * r + max(0.0, other_curvature) * other_r * other_r)
        value += bound_mixed_term(axis, corner, r, other_box)
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
def _bound_turning_normal_constant(
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
    """Bound E + gap / nx from above by a constant, for normals too near the vertical for planes."""
    sec, tan, foot, face, turn, _ = compute_axis_terms(which, side, width, height, box, gap)
    # Both are monotone; their sum need not be, as the gap is part of the face's distance.
    face_term = face * max(sec[0], sec[2]) + max(foot[0], foot[2])
    slope = max(turn * tan[0], turn * tan[2])
    upper_bound = -np.inf
    for v in range(4):
        p, q, u, w = compute_corner_terms(v, other_side, other_width, other_height)
        # Y_v >= 0, so that B_v + T Y_v is largest at the largest T.
        upper_bound = max(
            upper_bound, face_term + maximise_sinusoid(p + slope * u, q + slope * w, other_box)
        )
    return upper_bound


@compiled
def _bound_fixed_normal(
    nx: float, ny: float, side: float, width: float, height: float, box: Array
) -> tuple[float, float]:
    """Bound the largest nx X + ny Y of a book's corners over its angle box by a line above it."""
    r = box[6]
    first = last = -np.inf
    for v in range(4):
        p, q, u, w = compute_corner_terms(v, side, width, height)
        a, b = ny * u - nx * p, ny * w - nx * q
        value = a * box[2] + b * box[3] + 0.5 * max(0.0, -minimise_sinusoid(a, b, box)) * r * r
        slope = (a * box[3] - b * box[2]) * r
        first, last = max(first, value - slope), max(last, value + slope)
    return 0.5 * (first + last), (0.5 * (last - first) / r if r > 0 else 0.0)


@compiled
def bound_contact_distance(
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
    """Bound U for book i left of book j: U <= p + g da_i + h db_j.

    For boxes without width p is U itself.
    """
    end, feature, nx, ny = compute_contact_distance(
        side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
    )
    if box_i[6] == 0.0 and box_j[6] == 0.0:
        return end, 0.0, 0.0
    constant = np.inf
    if feature < 2:
        if not is_near_vertical(compute_axis_terms(feature, side_i, width_i, height_i, box_i, gap)):
            return _bound_turning_normal(
                feature, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
            )
        constant = _bound_turning_normal_constant(
            feature, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, gap
        )
    elif feature < 4:
        which = feature - 2
        if not is_near_vertical(compute_axis_terms(which, side_j, width_j, height_j, box_j, gap)):
            p, h, g = _bound_turning_normal(
                which, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
            )
            return p, g, h
        constant = _bound_turning_normal_constant(
            which, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i, gap
        )
    # Every direction gives a bound: the horizontal one, or the one from corner to corner.
    p_i, g = _bound_fixed_normal(1.0, 0.0, side_i, width_i, height_i, box_i)
    p_j, h = _bound_fixed_normal(1.0, 0.0, -side_j, width_j, height_j, box_j)
    p = p_i + p_j + gap
    if feature == 4 and nx > _TINY:
        p_i, slope_i = _bound_fixed_normal(nx, ny, side_i, width_i, height_i, box_i)
        p_j, slope_j = _bound_fixed_normal(nx, -ny, -side_j, width_j, height_j, box_j)
        if p_i + p_j + gap < p * nx:
            p, g, h = (p_i + p_j + gap) / nx, slope_i / nx, slope_j / nx
    if constant < p:
        return constant, 0.0, 0.0
    return p, g, h
