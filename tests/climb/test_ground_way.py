"""The body's way over ground: above steps, straight where nothing is below it, and few points."""

from __future__ import annotations

import numpy as np

from climbplan.climb.scene.ground_way import follow_ground
from climbplan.scan.contact_regions import FoundRegion


def level_region(low: float, high: float, height: float) -> FoundRegion:
    """A level strip of ground, 2 m wide, from `low` to `high` along y [m]."""
    corners = [[-1, low, height], [1, low, height], [1, high, height], [-1, high, height]]
    area = 2 * (high - low)
    return FoundRegion(np.array(corners, float), np.array([0.0, 0.0, 1.0]), "", area)


STAIRS = [level_region(-1.0, 0.4, 0.0)] + [
    level_region(0.4 + 0.3 * k, 0.7 + 0.3 * k, 0.15 * (k + 1)) for k in range(8)
]


def test_the_way_keeps_its_height_above_stairs() -> None:
    start, goal = np.array([0, 0, 0.5]), np.array([0, 2.4, 0.5 + 1.05])
    way = follow_ground(start, goal, STAIRS, 0.3)
    np.testing.assert_allclose(way[[0, -1]], [start, goal], atol=1e-12)
    assert 3 <= len(way) <= 10
    along = np.linspace(0.0, 2.4, 100)
    height = np.interp(along, way[:, 1], way[:, 2])
    slope = np.clip(0.5 * (along - 0.25), 0.0, None)  # through the edges of the steps
    assert (np.abs(height - 0.5 - slope) < 0.13).all()
    straight = np.interp(along, [0.0, 2.4], [0.5, 1.55])
    assert (height - straight).min() < -0.05, "it begins to rise where the stairs do"


def test_without_ground_the_way_is_straight() -> None:
    start, goal = np.array([0, 0, 0.5]), np.array([0, 2.4, 1.5])
    wall = FoundRegion(
        np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1.0]]), np.array([-1.0, 0, 0]), "", 0.5
    )
    for regions in ([], [wall]):
        np.testing.assert_array_equal(follow_ground(start, goal, regions, 0.3), [start, goal])
