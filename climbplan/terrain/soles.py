"""Positions of flat feet: the middle of a sole that lies on a region as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import Sole
from climbplan.terrain.surfaces import Region


def without_sole(region: Region, sole: Sole) -> Region:
    """Return the region without strips along its edges, as wide as a sole reaches towards each.

    Its half-spaces have no point in common where the sole is larger than the region; its corners
    are then those of the region.
    """
    strip = reach_of(region, sole)
    inside = shrink_region(region, strip)
    vertices = inside if len(inside) > 2 else region.vertices
    return replace(region, vertices=vertices, b=region.b - strip)


def fits(region: Region, sole: Sole) -> bool:
    """Return whether a sole fits on a region."""
    return len(shrink_region(region, reach_of(region, sole))) > 2


def reach_of(region: Region, sole: Sole) -> Array:
    """Return how far a sole on a region reaches from its middle towards each edge, (E,) [m]."""
    return np.asarray((region.A @ sole.arms(region.normal).T).max(axis=1))


def beyond(region: Region, sole: Sole, toe: Array) -> float:
    """Return how far a sole about a toe (3,) reaches beyond its region [m], negative inside."""
    return float((region.A @ toe - region.b + reach_of(region, sole)).max())


def shrink_region(region: Region, strip: Array) -> Array:
    """Return corners (K, 3) of a region without strips (E,) along its edges.

    Fewer than three: nothing is left.
    """
    vertices = region.vertices
    for row, bound in zip(region.A, region.b - strip, strict=True):
        if not len(vertices):
            break
        vertices = _clip_polygon(vertices, row, float(bound))
    return vertices


def _clip_polygon(vertices: Array, row: Array, bound: float) -> Array:
    """Return the part of a convex polygon (K, 3) with row . p <= bound."""
    height = vertices @ row - bound
    after, beyond = np.roll(vertices, -1, axis=0), np.roll(height, -1)
    kept_vertices = []
    for vertex, next_vertex, low, high in zip(vertices, after, height, beyond, strict=True):
        if low <= 0:
            kept_vertices.append(vertex)
        if (low < 0 < high) or (high < 0 < low):
            kept_vertices.append(vertex + low / (low - high) * (next_vertex - vertex))
    return np.array(kept_vertices).reshape(-1, 3)
