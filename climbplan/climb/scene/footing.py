"""Planned footing: contact regions without a strip along edges that end a surface.

A body that sags by some millimetres puts toes down as far from their places. An edge does not
matter where an equally good surface continues beyond it. Where there is none, or a slippery one,
the toe misses its surface. Checks use the full regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.foot import Foot
from climbplan.terrain.model import Terrain
from climbplan.terrain.soles import shrink_region, without_sole
from climbplan.terrain.surfaces import Region

_EDGE_SAMPLES = np.array(
    [0.1, 0.3, 0.5, 0.7, 0.9]
)  # places on an edge beyond which ground is looked for
_LEVEL_TOLERANCE = 2e-3  # [m] off the plane that still goes on
_MIN_FRICTION_RATIO = 0.9  # part of the friction coefficient
_GAP_TOLERANCE = 1e-3  # [m] by which ground beyond may begin late
_MAX_HALVINGS = 6  # of the strip, until something of the region is left
_ROUNDING = 1e-7  # [m] of rounding
_MIN_AREA_RATIO = 0.25  # part of the area that is left at least


def build_footing(terrain: Terrain, edge: float, foot: Foot | None = None) -> tuple[Region, ...]:
    """Return the regions of a terrain, each without a strip of `edge` [m]; () where nothing
    changes.

    Holds of grippers stay whole. Spherical feet also keep their radius and `edge` from what rises
    next to an edge, and flat feet are on their region as a whole.
    """
    if (edge <= 0 and foot is None) or terrain.is_curved:
        return ()
    trimmed = [
        _trim_region(terrain, index, edge, foot=foot) for index in range(len(terrain.regions))
    ]
    return _omit_unchanged(terrain, trimmed)


def add_goal_to_footing(
    terrain: Terrain,
    edge: float,
    without_goal: tuple[Region, ...],
    goal: tuple[Array, IntArray],
    foot: Foot | None = None,
) -> tuple[Region, ...]:
    """Return the footing with the goal's toes inside their regions.

    Args:
        terrain: The terrain.
        edge: Width of strips [m].
        without_goal: The footing without the goal; () where nothing changes.
        goal: Toes (N, 3) [m] and their regions (N,).
        foot: The robot's foot; None for points.
    """
    if not without_goal:
        return ()
    trimmed = list(without_goal)
    for index in sorted({int(r) for r in goal[1]}):
        trimmed[index] = _trim_region(terrain, index, edge, goal[0][goal[1] == index], foot)
    return _omit_unchanged(terrain, trimmed)


def _omit_unchanged(terrain: Terrain, trimmed: list[Region]) -> tuple[Region, ...]:
    """Return the trimmed regions, or () if none differs from the terrain's."""
    if all(region is original for region, original in zip(trimmed, terrain.regions, strict=True)):
        return ()
    return tuple(trimmed)


def _trim_region(
    terrain: Terrain, index: int, edge: float, toes: Array | None = None, foot: Foot | None = None
) -> Region:
    """Return one region without its strips; toes (K, 3) stay in it."""
    region = terrain.regions[index]
    if region.hold is not None:
        return region
    strips: Array = np.zeros(len(region.b))
    if edge > 0:
        strips = np.where(_find_continued_edges(terrain, index, edge), 0.0, edge)
    if foot is not None and foot.radius > 0:
        rising_widths = _measure_rising_edges(terrain, region, foot.radius)
        strips = np.maximum(strips, np.where(rising_widths > 0, rising_widths + edge, 0.0))
    if toes is not None:
        toe_distances = (region.b - toes @ region.A.T).min(axis=0, initial=np.inf)
        strips = np.minimum(strips, np.maximum(toe_distances, 0.0))
    if foot is None or foot.sole is None:
        return _remove_strips(region, strips)
    # Of the strips for edges some may be lost, of that for the sole nothing
    return _remove_strips(without_sole(region, foot.sole), strips)


def _measure_rising_edges(terrain: Terrain, region: Region, radius: float) -> Array:
    """Return widths (E,) that feet of a radius keep from edges next to rising solids."""
    corner = region.vertices
    edges = np.roll(corner, -1, axis=0) - corner
    points = corner[:, None] + _EDGE_SAMPLES[:, None] * edges[:, None]
    low, high = corner.min(axis=0) - radius, corner.max(axis=0) + radius
    strip = np.zeros(len(corner))
    for solid in terrain.solids:
        if (solid.vertices.min(axis=0) > high).any() or (solid.vertices.max(axis=0) < low).any():
            continue
        # Of what a foot stands on its centre is just that far off
        overlap = radius - _ROUNDING - solid.face_distance(points).min(axis=1)
        strip = np.maximum(strip, np.where(overlap > 0, overlap + _ROUNDING, 0.0))
    return np.minimum(strip, radius)


def _find_continued_edges(terrain: Terrain, index: int, edge: float) -> BoolArray:
    """Return edges (E,) of a region beyond which other regions, as good, support the same limbs."""
    regions, allowed = terrain.regions, terrain.allowed
    lower, upper = terrain.bounds
    region = regions[index]
    search_distance = edge + _LEVEL_TOLERANCE + _GAP_TOLERANCE
    low, high = (
        region.vertices.min(axis=0) - search_distance,
        region.vertices.max(axis=0) + search_distance,
    )
    nearby = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
    neighbours: Sequence[Region] = [
        neighbour
        for k, neighbour in ((int(k), regions[k]) for k in nearby)
        if k != index
        and neighbour.hold is None
        and neighbour.friction >= _MIN_FRICTION_RATIO * region.friction
        and allowed[allowed[:, index], k].all()
    ]
    corner = region.vertices
    edges = np.roll(corner, -1, axis=0) - corner
    points = corner[:, None] + _EDGE_SAMPLES[:, None] * edges[:, None] + edge * region.A[:, None]
    is_continued = np.zeros(points.shape[:2], bool)  # (E, points)
    for neighbour in neighbours:
        if neighbour.normal @ region.normal <= 0:
            continue
        level = np.abs(points @ neighbour.normal - neighbour.offset) <= _LEVEL_TOLERANCE
        is_continued |= level & (points @ neighbour.A.T <= neighbour.b + _GAP_TOLERANCE).all(
            axis=-1
        )
    return np.asarray(is_continued.all(axis=1))


def _remove_strips(region: Region, strip: Array) -> Region:
    """Return a region without strips (E,) along its edges; narrower ones where little would be
    left.
    """
    if not strip.any():
        return region
    full_area = _compute_area(region.vertices)
    for _ in range(_MAX_HALVINGS):
        vertices = shrink_region(region, strip)
        if len(vertices) > 2 and _compute_area(vertices) >= _MIN_AREA_RATIO * full_area:
            return replace(region, vertices=vertices, b=region.b - strip)
        strip = strip / 2
    return region


def _compute_area(vertices: Array) -> float:
    """Return the area of a convex polygon (K, 3)."""
    fan = np.cross(vertices[1:-1] - vertices[0], vertices[2:] - vertices[0])
    return float(np.linalg.norm(fan, axis=1).sum() / 2)
