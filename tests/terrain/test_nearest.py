"""The nearest of many regions, found by their bounds, is that of asking all of them."""

from __future__ import annotations

import numpy as np

from climbplan.terrain.nearest import beyond_bounds, bounds_of, nearest_region
from climbplan.terrain.surfaces import Region


def triangles(count: int) -> list[Region]:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.uniform(-0.2, 0.2, (count, 3, 3))
    return [Region.from_vertices(f"r{k}", own, 1.0) for k, own in enumerate(corners)]


def test_the_nearest_of_some_is_that_of_asking_all() -> None:
    regions = triangles(80)
    bounds = bounds_of(regions)
    some = np.arange(0, 80, 3)
    for point in np.random.default_rng(4).uniform(-1.5, 1.5, (50, 3)):
        asked = [regions[k].distance(point) for k in some]
        assert nearest_region(regions, bounds, some, point) == some[int(np.argmin(asked))]
        every = [region.distance(point) for region in regions]
        assert (beyond_bounds(bounds, point) <= np.array(every) + 1e-12).all()


def test_of_equally_near_ones_it_is_the_first() -> None:
    twice = triangles(1) * 2
    assert nearest_region(twice, bounds_of(twice), np.arange(2), np.ones(3)) == 0
