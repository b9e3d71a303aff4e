"""Check whether listed points make a usable polygon or solid.

Plain Python on purpose: specs hold a few dozen points, and `validate` then needs no numpy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

Point = Sequence[float]

FLATNESS = 1e-6  # [m] largest distance of a corner from the plane of all
SMALLEST_AREA = 1e-8  # [m^2]
SMALLEST_VOLUME = 1e-12  # [m^3]


def _subtract(a: Point, b: Point) -> tuple[float, float, float]:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _cross(a: Point, b: Point) -> tuple[float, float, float]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def check_polygon(corners: Sequence[Point]) -> str | None:
    """Return what keeps `corners` (n, 3) [m] from being a flat convex polygon; None if they are
    one.
    """
    if len(corners) < 3:
        return f"expected at least three corners, got {len(corners)}"
    # Twice the area vector; its direction is the polygon's normal (Newell).
    fan = [
        _cross(_subtract(a, corners[0]), _subtract(b, corners[0])) for a, b in pairwise(corners[1:])
    ]
    doubled = tuple(sum(v[k] for v in fan) for k in range(3))
    area = math.hypot(*doubled) / 2
    if area < SMALLEST_AREA:
        return "the corners lie on one line: the region is empty"
    normal = tuple(v / (2 * area) for v in doubled)
    offsets = [_dot(corner, normal) for corner in corners]
    mean = sum(offsets) / len(offsets)
    off = max(abs(offset - mean) for offset in offsets)
    if off > FLATNESS:
        return f"expected a flat polygon, but its corners are {1e3 * off:.3g} mm off their plane"
    total_turn = 0.0
    for i, corner in enumerate(corners):
        before = _subtract(corner, corners[i - 1])
        after = _subtract(corners[(i + 1) % len(corners)], corner)
        if math.hypot(*before) == 0.0:
            return f"corner {i} repeats the one before it"
        turn = math.atan2(_dot(_cross(before, after), normal), _dot(before, after))
        if turn < -1e-6:
            return f"expected a convex polygon, but it turns inwards at corner {i}"
        total_turn += turn
    if total_turn > 2 * math.pi + 1e-3:
        return "expected a convex polygon, but its edges cross"
    return None


def check_hull(points: Sequence[Point]) -> str | None:
    """Return what keeps the hull of `points` (n, 3) [m] from being a solid; None if it is one."""
    if len(points) < 4:
        return f"expected at least four points, got {len(points)}"
    origin = points[0]
    # The farthest point, then the widest triangle, then the tallest tetrahedron on it.
    first = max((_subtract(p, origin) for p in points), key=lambda d: math.hypot(*d))
    face = max(
        (_cross(first, _subtract(p, origin)) for p in points), key=lambda area: math.hypot(*area)
    )
    if max(abs(_dot(face, _subtract(p, origin))) for p in points) / 6 < SMALLEST_VOLUME:
        return "the points lie in one plane: the solid is empty"
    return None
