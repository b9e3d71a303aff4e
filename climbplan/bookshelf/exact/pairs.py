"""Smallest separation of two books on the ground: closed form and proven lower bounds.

A book tilted by alpha in [0, pi/2] to the side s (+1 left, -1 right; upright is alpha = 0, flat is
alpha = pi/2) touches the ground with one bottom corner, its foot. Book i is left of book j without
overlap exactly if x_j - x_i >= D(alpha_i, alpha_j), where D is the least over the four face normals
that point from i to j of E, the largest over the other book's corners v of

    P_v = A(alpha) + s c(alpha) + B_v(beta) + T(alpha) Y_v(beta)                             (*)

for a normal of the book (s, alpha) and the other book (s', beta). With the normal (nx, ny), nx > 0:
A is the face's distance from the foot over nx, T = -ny / nx, s c the foot's offset from the centre,
-B_v and Y_v the corner's position relative to centre and ground. B_v and Y_v are of the form
p sin(beta) + q cos(beta) with Y_v >= 0. Normals of the right book are those of the left one with
both books mirrored.

On a box of angles every part of (*) is monotone or of the form p sin + q cos, so that its range is
exact at the end points; sums and products of ranges give the constant bounds, and a Taylor
polynomial of degree one with the range of the second derivatives over the box gives the planes.
Books that may penetrate each other by `depth` are held off by faces that lie so much farther in.
Nothing is sampled; arithmetic is in double precision without directed rounding.

An angle box is the row (sin, cos at its lower end, its middle, its upper end, half width).
Lengths in mm.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.exact.compiling import compiled

_STEEP = 0.03  # below this normal's x component planes give way to constants
_TINY = 1e-12

CornerNumbers = tuple[float, float, float, float]
AxisNumbers = tuple[
    tuple[float, float, float],
    tuple[float, float, float],
    tuple[float, float, float, float],
    float,
    float,
    float,
]


@compiled
def fill_angle_box(low: float, high: float, row: Array) -> None:
    """Fill `row` (7,) with sines and cosines of the angle box [low, high]."""
    middle = 0.5 * (low + high)
    row[0], row[1] = math.sin(low), math.cos(low)
    row[2], row[3] = math.sin(middle), math.cos(middle)
    row[4], row[5] = math.sin(high), math.cos(high)
    row[6] = 0.5 * (high - low)


@compiled
def maximise_sinusoid(p: float, q: float, box: Array) -> float:
    """Return the largest value of p sin + q cos over an angle box within [0, pi/2]."""
    top = max(p * box[0] + q * box[1], p * box[4] + q * box[5])
    # The derivative p cos - q sin changes sign inside the box.
    if p > 0 and q > 0 and p * box[1] > q * box[0] and p * box[5] < q * box[4]:
        top = math.sqrt(p * p + q * q)
    return top


@compiled
def minimise_sinusoid(p: float, q: float, box: Array) -> float:
    """Return the smallest value of p sin + q cos over an angle box within [0, pi/2]."""
    return -maximise_sinusoid(-p, -q, box)


@compiled
def compute_corner_terms(v: int, side: float, width: float, height: float) -> CornerNumbers:
    """Compute p, q of B_v and of Y_v for a corner.

    v: 0 the foot, 1 the far end of the height, 2 the far end of the width, 3 the opposite corner.
    """
    up = 1.0 if v == 1 or v == 3 else -1.0
    across = -1.0 if v == 2 or v == 3 else 1.0
    return (
        up * side * height / 2,
        across * side * width / 2,
        width if across < 0 else 0.0,
        height if up > 0 else 0.0,
    )


@compiled
def compute_axis_terms(
    which: int, side: float, width: float, height: float, box: Array, extra: float
) -> AxisNumbers:
    """Compute the terms of (*) for one right-pointing face normal over an angle box.

    `which` 0 is the face along the height (normal cos alpha, +-sin alpha), 1 the face along the
    width (normal sin alpha, -+cos alpha), which is the first one for pi/2 - alpha. `extra` is
    added to the face's distance. Returns 1 / nx and |ny| / nx at the lower end, the middle and the
    upper end; s c there and its derivative in the middle; the face's distance from the foot; the
    signs of T and of d|T| / d alpha.
    """
    first = which == 0
    nx0, ny0 = (box[1], box[0]) if first else (box[0], box[1])
    nx1, ny1 = (box[3], box[2]) if first else (box[2], box[3])
    nx2, ny2 = (box[5], box[4]) if first else (box[4], box[5])
    sec0, sec1, sec2 = 1 / max(nx0, _TINY), 1 / max(nx1, _TINY), 1 / max(nx2, _TINY)
    far = (width if side > 0 else 0.0) if first else (0.0 if side > 0 else height)
    sigma = 1.0 if first else -1.0
    return (
        (sec0, sec1, sec2),
        (ny0 * sec0, ny1 * sec1, ny2 * sec2),
        (
            0.5 * side * (height * box[0] - width * box[1]),
            0.5 * side * (height * box[2] - width * box[3]),
            0.5 * side * (height * box[4] - width * box[5]),
            0.5 * side * (height * box[3] + width * box[2]),
        ),
        far + extra,
        -side * sigma,
        sigma,
    )


@compiled
def is_near_vertical(axis: AxisNumbers) -> bool:
    """Return whether the normal comes so near to the vertical that planes are not tight."""
    sec, _, _, _, _, _ = axis
    return max(sec[0], sec[2]) * _STEEP > 1


@compiled
def expand_taylor(
    axis: AxisNumbers, side: float, corner: CornerNumbers, other_box: Array
) -> tuple[float, float, float]:
    """Expand P_v to first order in both tilts about the middle of the boxes."""
    sec, tan, foot, face, turn, sigma = axis
    p, q, u, w = corner
    s, c = other_box[2], other_box[3]
    slope = turn * tan[1]
    value = face * sec[1] + foot[1] + (p + slope * u) * s + (q + slope * w) * c
    tilt_slope = sigma * face * sec[1] * tan[1] + foot[3] - side * sec[1] * sec[1] * (u * s + w * c)
    other_tilt_slope = (p + slope * u) * c - (q + slope * w) * s
    return value, tilt_slope, other_tilt_slope


@compiled
def bound_mixed_term(axis: AxisNumbers, corner: CornerNumbers, r: float, other_box: Array) -> float:
    """Bound the absolute mixed second-order term of P_v on the boxes."""
    sec, _, _, _, _, _ = axis
    _, _, u, w = corner
    largest = max(sec[0], sec[2])
    # dY/d beta falls all along the box, so that it is largest in size at an end.
    first = abs(u * other_box[1] - w * other_box[0])
    last = abs(u * other_box[5] - w * other_box[4])
    return largest * largest * max(first, last) * r * other_box[6]


@compiled
def bound_curvature(
    axis: AxisNumbers, corner: CornerNumbers, other_box: Array, depth: float
) -> float:
    """Bound the second derivative of P_v by the own tilt on the boxes from below."""
    sec, tan, foot, face, turn, _ = axis
    _, _, u, w = corner
    low = min(sec[0], sec[2]), min(tan[0], tan[2])
    high = max(sec[0], sec[2]), max(tan[0], tan[2])
    # Least second derivatives: T'' = 2 turn |T| / nx^2, Y_v'' = -Y_v, (s c)'' = -s c.
    end = low if face >= 0 else high
    curvature = face * end[0] * (end[0] * end[0] + end[1] * end[1]) - max(foot[0], foot[2])
    if turn > 0 and depth > 0 and minimise_sinusoid(u, w, other_box) >= depth:
        # T'' (Y_v - depth) and, of T'' depth + A'', - depth / nx / (1 / nx + |T|)^2
        curvature = -depth * low[0] / (low[0] + low[1]) ** 2 - max(foot[0], foot[2])
        curvature += 2 * low[1] * low[0] * low[0] * (minimise_sinusoid(u, w, other_box) - depth)
    elif turn > 0:
        curvature += 2 * low[1] * low[0] * low[0] * minimise_sinusoid(u, w, other_box)
    else:
        curvature -= 2 * high[1] * high[0] * high[0] * maximise_sinusoid(u, w, other_box)
    return curvature


@compiled
def bound_axis_separation(
    which: int,
    side: float,
    width: float,
    height: float,
    box: Array,
    other_side: float,
    other_width: float,
    other_height: float,
    other_box: Array,
    aim: float,
    depth: float,
) -> tuple[float, float, float, float]:
    """Bound E of one face normal from below: E >= k, E >= p + g da + h db on the boxes.

    da, db are the differences of the own and of the other tilt from the boxes' middles. The plane
    is that of one corner v: the one with the largest P_v in the middle of the boxes, or for `aim`
    1 or -1 where the own tilt is largest and the other least, or the other way round.
    """
    axis = compute_axis_terms(which, side, width, height, box, -depth)
    sec, tan, foot, face, turn, _ = axis
    face_term = min(face * sec[0] + foot[0], face * sec[2] + foot[2])  # A + s c is monotone
    if face < 0:  # only A and s c each are
        face_term = min(face * sec[0], face * sec[2]) + min(foot[0], foot[2])
    slope = min(turn * tan[0], turn * tan[2])
    tangent, s, c = turn * tan[1], other_box[2], other_box[3]
    if aim > 0:
        tangent, s, c = turn * tan[2], other_box[0], other_box[1]
    elif aim < 0:
        tangent, s, c = turn * tan[0], other_box[4], other_box[5]
    constant, best, value = -np.inf, 0, -np.inf
    for v in range(4):
        p, q, u, w = compute_corner_terms(v, other_side, other_width, other_height)
        # Y_v >= 0, so that B_v + T Y_v is least at the least T.
        start = face_term
        if turn > 0 and depth > 0 and minimise_sinusoid(u, w, other_box) >= depth:
            # The face goes through the foot: A + T Y_v = |T| Y_v - depth / nx grows with |T|.
            start = -depth * min(sec[0], sec[2]) + min(foot[0], foot[2])
        constant = max(constant, start + minimise_sinusoid(p + slope * u, q + slope * w, other_box))
        candidate = (p + tangent * u) * s + (q + tangent * w) * c
        if candidate > value:
            best, value = v, candidate
    if is_near_vertical(axis):
        return constant, -np.inf, 0.0, 0.0

    corner = compute_corner_terms(best, other_side, other_width, other_height)
    p, q, u, w = corner
    plane, g, h = expand_taylor(axis, side, corner, other_box)
    curvature = bound_curvature(axis, corner, other_box, depth)
    slope = max(turn * tan[0], turn * tan[2])
    other_curvature = -maximise_sinusoid(p + slope * u, q + slope * w, other_box)
    r, other_r = box[6], other_box[6]
    plane += 0.5 * (min(0.0, curvature) * r * r + min(0.0, other_curvature) * other_r * other_r)
    return constant, plane - bound_mixed_term(axis, corner, r, other_box), g, h


@compiled
def bound_pair_separation(
    side_i: float,
    width_i: float,
    height_i: float,
    box_i: Array,
    side_j: float,
    width_j: float,
    height_j: float,
    box_j: Array,
    aim: float,
    depth: float = 0.0,
) -> tuple[float, float, float, float]:
    """Bound D for book i left of book j from below: D >= k, D >= p + g da_i + h da_j.

    With boxes of no width both are D itself. Where two books lean on each other face to face, D has
    a crease: planes with `aim` 1 (i tilted more) and -1 (i tilted less) are those of its two sides,
    with 0 that of the middle of the boxes. depth: by which the books may penetrate each other.
    """
    constant = np.inf
    corner_00 = corner_01 = corner_10 = corner_11 = np.inf
    r_i, r_j = box_i[6], box_j[6]
    for axis in range(4):
        if axis < 2:
            k, p, g, h = bound_axis_separation(
                axis, side_i, width_i, height_i, box_i, side_j, width_j, height_j, box_j, aim,
                depth,
            )  # fmt: skip
        else:
            k, p, h, g = bound_axis_separation(
                axis - 2, -side_j, width_j, height_j, box_j, -side_i, width_i, height_i, box_i,
                -aim, depth,
            )  # fmt: skip
        constant = min(constant, k)
        if p < k:
            p, g, h = k, 0.0, 0.0
        # The least of planes is concave: a plane below its corner values is below it.
        corner_00 = min(corner_00, p - g * r_i - h * r_j)
        corner_01 = min(corner_01, p - g * r_i + h * r_j)
        corner_10 = min(corner_10, p + g * r_i - h * r_j)
        corner_11 = min(corner_11, p + g * r_i + h * r_j)
    if r_i == 0.0 and r_j == 0.0:
        return constant, constant, 0.0, 0.0
    gradient_i = gradient_j = 0.0
    if r_i > 0:
        gradient_i = (corner_10 + corner_11 - corner_00 - corner_01) / (4 * r_i)
    if r_j > 0:
        gradient_j = (corner_01 + corner_11 - corner_00 - corner_10) / (4 * r_j)
    plane = min(
        min(
            corner_00 + gradient_i * r_i + gradient_j * r_j,
            corner_01 + gradient_i * r_i - gradient_j * r_j,
        ),
        min(
            corner_10 - gradient_i * r_i + gradient_j * r_j,
            corner_11 - gradient_i * r_i - gradient_j * r_j,
        ),
    )
    return constant, plane, gradient_i, gradient_j
