"""The nearest of many flat regions to a point: by bounds first, exactly where they leave it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.terrain.surfaces import Region

_SLACK = 1e-9  # [m] for rounding


def bounds_of(regions: Sequence[Region]) -> Array:
    """Least and largest coordinates of regions, (2, R, 3) [m]."""
    corners = [region.vertices for region in regions]
    return np.array([[v.min(axis=0) for v in corners], [v.max(axis=0) for v in corners]])


def beyond_bounds(bounds: Array, points: Array) -> Array:
    """Distances (..., R) of points (..., 3) from bounds (2, R, 3), never more than from regions."""
    low, high = bounds
    place = points[..., None, :]
    away = np.maximum(np.maximum(low - place, place - high), 0.0)
    return np.asarray(np.linalg.norm(away, axis=-1))


def nearest_region(
    regions: Sequence[Region], bounds: Array, candidates: NDArray[np.integer[Any]], point: Array
) -> int:
    """The candidate nearest to a point (3,), the first of several that are equally near.

    bounds: (2, R, 3) of all regions.
    """
    least = beyond_bounds(bounds[:, candidates], point)
    best, chosen = np.inf, -1
    for place in np.argsort(least, kind="stable"):
        if least[place] > best + _SLACK:
            break
        number = int(candidates[place])
        away = regions[number].distance(point)
        if away < best or (away == best and number < chosen):
            best, chosen = away, number
    return chosen
