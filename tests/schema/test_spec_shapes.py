"""Polygons and hulls that are none."""

from __future__ import annotations

import math

import pytest

from climbplan.schema.terrain.shapes import check_hull, check_polygon

SQUARE = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0.0, 1.0, 1.0)]
STAR = [
    (math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5), 0.0) for k in range(5)
]  # turns the same way at every corner, twice round
CUBE = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]


def test_good_shapes() -> None:
    assert check_polygon(SQUARE) is None
    assert check_polygon(SQUARE[::-1]) is None
    assert check_polygon([SQUARE[0], (0.5, 0.0, 1.0), *SQUARE[1:]]) is None  # a corner on an edge
    assert check_hull(CUBE) is None


@pytest.mark.parametrize(
    ("corners", "fragment"),
    [
        (SQUARE[:2], "at least three"),
        ([(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2.0, 2.0, 2.0)], "one line"),
        ([*SQUARE[:3], (0.0, 1.0, 1.01)], "off their plane"),
        ([SQUARE[0], (0.2, 0.2, 1.0), *SQUARE[1:]], "turns inwards"),
        ([SQUARE[0], SQUARE[0], *SQUARE[1:]], "repeats"),
        (STAR, "edges cross"),
    ],
)
def test_polygons_that_are_none(corners: list[tuple[float, float, float]], fragment: str) -> None:
    fault = check_polygon(corners)
    assert fault is not None
    assert fragment in fault


@pytest.mark.parametrize(
    ("points", "fragment"),
    [
        (SQUARE, "one plane"),
        ([(0.0, 0.0, 0.0)] * 5, "one plane"),
        ([(float(k), 0.0, 0.0) for k in range(5)], "one plane"),
        (SQUARE[:3], "at least four"),
    ],
)
def test_hulls_that_are_none(points: list[tuple[float, float, float]], fragment: str) -> None:
    fault = check_hull(points)
    assert fault is not None
    assert fragment in fault
