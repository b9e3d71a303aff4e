"""The plane and outline of a foothold region, from its corners in space.

Plain Python on purpose: specs hold a few dozen points, and `validate` then needs no numpy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

Pair = tuple[float, float]
Point = tuple[float, float, float]

_LEVEL = 1e-6  # rise below which a plane is level: the rounding of mesh files
_ALIGNED = 1e-6  # [m] by which corners of a rectangle along the axes may be off


class RegionPlane(NamedTuple):
    """A convex polygon seen from above, and the plane that it lies in."""

    outline: tuple[Pair, ...]  # counterclockwise seen from above [m]
    slope: Pair  # rise along x and y
    point: Point  # a point of the plane [m]


def read_polygon_plane(corners: Sequence[Point]) -> RegionPlane | None:
    """Return the plane of a flat polygon; None if it does not face up.

    Args:
        corners: Corners (n, 3), anticlockwise seen from free space [m].
    """
    x, y, z = corners[0]
    normal = [0.0, 0.0, 0.0]
    spokes = [(c[0] - x, c[1] - y, c[2] - z) for c in corners[1:]]
    for a, b in pairwise(spokes):
        normal[0] += a[1] * b[2] - a[2] * b[1]
        normal[1] += a[2] * b[0] - a[0] * b[2]
        normal[2] += a[0] * b[1] - a[1] * b[0]
    if normal[2] <= 1e-9 * math.hypot(*normal):
        return None
    rise = [-normal[k] / normal[2] for k in range(2)]
    slope_x, slope_y = (value if abs(value) > _LEVEL else 0.0 for value in rise)
    middle = [sum(c[k] for c in corners) / len(corners) for k in range(3)]
    return RegionPlane(
        tuple((c[0], c[1]) for c in corners),
        (slope_x, slope_y),
        (middle[0], middle[1], middle[2]),
    )


def list_rectangle_corners(
    center: Point, normal: Point, width: float, height: float
) -> tuple[Point, ...]:
    """Return the corners of a rectangle whose width is horizontal, along x if it is level.

    Args:
        center: Its centre (3,) [m].
        normal: Direction (3,) into free space.
        width: Horizontal extent [m].
        height: Extent along the slope [m].
    """
    length = math.hypot(*normal)
    nx, ny, nz = (component / length for component in normal)
    level = math.hypot(nx, ny)
    across = (-ny / level, nx / level, 0.0) if level > 1e-9 else (1.0, 0.0, 0.0)
    up = (
        ny * across[2] - nz * across[1],
        nz * across[0] - nx * across[2],
        nx * across[1] - ny * across[0],
    )
    return tuple(
        (
            center[0] + i * width * across[0] + j * height * up[0],
            center[1] + i * width * across[1] + j * height * up[1],
            center[2] + i * width * across[2] + j * height * up[2],
        )
        for i, j in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    )


def is_axis_aligned(outline: Sequence[Pair]) -> bool:
    """Return whether a polygon seen from above is a rectangle along x and y."""
    if len(outline) != 4:
        return False
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = outline
    pairs = ((x0, x3), (x1, x2), (y0, y1), (y2, y3)), ((x0, x1), (x2, x3), (y0, y3), (y1, y2))
    return any(all(abs(a - b) <= _ALIGNED for a, b in sides) for sides in pairs)
