"""Where a flat foot may stand: the middle of a sole that is on a region as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import Sole
from climbplan.terrain.surfaces import Region


def without_sole(region: Region, sole: Sole) -> Region:
    """The region without strips along its edges, as wide as a sole reaches towards each.

    Its half spaces have no point in common where the sole is larger than the region; its corners
    are then those of the region.
    """
    strip = reach_of(region, sole)
    inside = shrunk(region, strip)
    vertices = inside if len(inside) > 2 else region.vertices
    return replace(region, vertices=vertices, b=region.b - strip)


def fits(region: Region, sole: Sole) -> bool:
    """Whether a region has room for a sole."""
    return len(shrunk(region, reach_of(region, sole))) > 2


def reach_of(region: Region, sole: Sole) -> Array:
    """(E,) how far a sole on a region reaches from its middle towards each edge [m]."""
    return np.asarray((region.A @ sole.arms(region.normal).T).max(axis=1))


def beyond(region: Region, sole: Sole, toe: Array) -> float:
    """How far a sole about a toe (3,) reaches beyond its region [m]; below zero inside."""
    return float((region.A @ toe - region.b + reach_of(region, sole)).max())


def shrunk(region: Region, strip: Array) -> Array:
    """Corners (K, 3) of a region without strips (E,) along its edges; too few: nothing is left."""
    vertices = region.vertices
    for row, bound in zip(region.A, region.b - strip, strict=True):
        if not len(vertices):
            break
        vertices = _cut(vertices, row, float(bound))
    return vertices


def _cut(vertices: Array, row: Array, bound: float) -> Array:
    """The part of a convex polygon (K, 3) with row . p <= bound."""
    height = vertices @ row - bound
    after, beyond = np.roll(vertices, -1, axis=0), np.roll(height, -1)
    out = []
    for here, there, low, high in zip(vertices, after, height, beyond, strict=True):
        if low <= 0:
            out.append(here)
        if (low < 0 < high) or (high < 0 < low):
            out.append(here + low / (low - high) * (there - here))
    return np.array(out).reshape(-1, 3)
