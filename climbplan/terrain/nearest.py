"""The nearest of many flat regions to a point: by bounds first, then exactly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.terrain.surfaces import Region

_SLACK = 1e-9  # [m] for rounding


def bounds_of(regions: Sequence[Region]) -> Array:
    """Return lower and upper bounds of the coordinates of regions, (2, R, 3) [m]."""
    corners = [region.vertices for region in regions]
    return np.array([[v.min(axis=0) for v in corners], [v.max(axis=0) for v in corners]])


def beyond_bounds(bounds: Array, points: Array) -> Array:
    """Return distances (..., R) of points (..., 3) from bounds (2, R, 3).

    They are lower bounds of the distances from regions.
    """
    low, high = bounds
    place = points[..., None, :]
    excess = np.maximum(np.maximum(low - place, place - high), 0.0)
    return np.asarray(np.linalg.norm(excess, axis=-1))


def nearest_region(
    regions: Sequence[Region], bounds: Array, candidates: NDArray[np.integer[Any]], point: Array
) -> int:
    """Return the candidate nearest to a point (3,), the first of several that are equally near.

    Args:
        regions: All regions.
        bounds: Bounds (2, R, 3) of all regions [m].
        candidates: Numbers of regions.
        point: (3,) [m].
    """
    lower_bounds = beyond_bounds(bounds[:, candidates], point)
    min_distance, nearest = np.inf, -1
    for place in np.argsort(lower_bounds, kind="stable"):
        if lower_bounds[place] > min_distance + _SLACK:
            break
        number = int(candidates[place])
        distance = regions[number].distance(point)
        if distance < min_distance or (distance == min_distance and number < nearest):
            min_distance, nearest = distance, number
    return nearest
