"""Where toes are planned to stand: contact regions without a strip along edges that end something.

A robot whose body sags by some millimetres puts its toes down as far aside. Where a surface that is
as good goes on beyond an edge that does not matter; where there is none, or a slippery one, the toe
misses its surface. Regions stay what they are for whatever is checked.
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

_ALONG = np.array([0.1, 0.3, 0.5, 0.7, 0.9])  # places on an edge beyond which ground is looked for
_LEVEL = 2e-3  # [m] off the plane that still goes on
_AS_GOOD = 0.9  # part of the friction coefficient
_SLACK = 1e-3  # [m] by which ground beyond may begin late
_HALVINGS = 6  # of the strip, until something of the region is left
_SLIGHT = 1e-7  # [m] of rounding
_LEFT = 0.25  # part of the area that is left at least


def footing(terrain: Terrain, edge: float, foot: Foot | None = None) -> tuple[Region, ...]:
    """The regions of a terrain, each without a strip of `edge` [m]; () where nothing changes.

    Holds of grippers stay whole. Spherical feet also stay off what rises beside an edge, by
    their radius and `edge`, and flat ones are on their region as a whole.
    """
    if (edge <= 0 and foot is None) or terrain.is_curved:
        return ()
    kept = [_kept(terrain, index, edge, foot=foot) for index in range(len(terrain.regions))]
    return _changed(terrain, kept)


def footing_with_goal(
    terrain: Terrain,
    edge: float,
    plain: tuple[Region, ...],
    goal: tuple[Array, IntArray],
    foot: Foot | None = None,
) -> tuple[Region, ...]:
    """The same with toes (N, 3) of the goal left in their regions (N,); plain: without them."""
    if not plain:
        return ()
    kept = list(plain)
    for index in sorted({int(r) for r in goal[1]}):
        kept[index] = _kept(terrain, index, edge, goal[0][goal[1] == index], foot)
    return _changed(terrain, kept)


def _changed(terrain: Terrain, kept: list[Region]) -> tuple[Region, ...]:
    if all(new is old for new, old in zip(kept, terrain.regions, strict=True)):
        return ()
    return tuple(kept)


def _kept(
    terrain: Terrain, index: int, edge: float, toes: Array | None = None, foot: Foot | None = None
) -> Region:
    """One region without its strips; toes (K, 3) stay in it."""
    region = terrain.regions[index]
    if region.hold is not None:
        return region
    strip: Array = np.zeros(len(region.b))
    if edge > 0:
        strip = np.where(_goes_on(terrain, index, edge), 0.0, edge)
    if foot is not None and foot.radius > 0:
        beside = _beside(terrain, region, foot.radius)
        strip = np.maximum(strip, np.where(beside > 0, beside + edge, 0.0))
    if toes is not None:
        room = (region.b - toes @ region.A.T).min(axis=0, initial=np.inf)
        strip = np.minimum(strip, np.maximum(room, 0.0))
    if foot is None or foot.sole is None:
        return _without(region, strip)
    # Of the strips for edges some may be lost, of that for the sole nothing
    return _without(without_sole(region, foot.sole), strip)


def _beside(terrain: Terrain, region: Region, radius: float) -> Array:
    """(E,) widths that feet of that radius keep from edges of a region beside what rises there."""
    corner = region.vertices
    along = np.roll(corner, -1, axis=0) - corner
    points = corner[:, None] + _ALONG[:, None] * along[:, None]
    low, high = corner.min(axis=0) - radius, corner.max(axis=0) + radius
    strip = np.zeros(len(corner))
    for solid in terrain.solids:
        if (solid.vertices.min(axis=0) > high).any() or (solid.vertices.max(axis=0) < low).any():
            continue
        # Of what a foot stands on its centre is just that far off
        near = radius - _SLIGHT - solid.face_distance(points).min(axis=1)
        strip = np.maximum(strip, np.where(near > 0, near + _SLIGHT, 0.0))
    return np.minimum(strip, radius)


def _goes_on(terrain: Terrain, index: int, edge: float) -> BoolArray:
    """(E,) edges of a region beyond which other regions, as good, hold the same limbs."""
    regions, allowed = terrain.regions, terrain.allowed
    lower, upper = terrain.bounds
    region = regions[index]
    beside = edge + _LEVEL + _SLACK
    low, high = region.vertices.min(axis=0) - beside, region.vertices.max(axis=0) + beside
    near = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
    others: Sequence[Region] = [
        other
        for k, other in ((int(k), regions[k]) for k in near)
        if k != index
        and other.hold is None
        and other.friction >= _AS_GOOD * region.friction
        and allowed[allowed[:, index], k].all()
    ]
    corner = region.vertices
    along = np.roll(corner, -1, axis=0) - corner
    points = corner[:, None] + _ALONG[:, None] * along[:, None] + edge * region.A[:, None]
    found = np.zeros(points.shape[:2], bool)  # (E, points)
    for other in others:
        if other.normal @ region.normal <= 0:
            continue
        level = np.abs(points @ other.normal - other.offset) <= _LEVEL
        found |= level & (points @ other.A.T <= other.b + _SLACK).all(axis=-1)
    return np.asarray(found.all(axis=1))


def _without(region: Region, strip: Array) -> Region:
    """A region without strips (E,) along its edges; narrower ones where little would be left."""
    if not strip.any():
        return region
    whole = _area(region.vertices)
    for _ in range(_HALVINGS):
        vertices = shrink_region(region, strip)
        if len(vertices) > 2 and _area(vertices) >= _LEFT * whole:
            return replace(region, vertices=vertices, b=region.b - strip)
        strip = strip / 2
    return region


def _area(vertices: Array) -> float:
    """Of a convex polygon (K, 3)."""
    fan = np.cross(vertices[1:-1] - vertices[0], vertices[2:] - vertices[0])
    return float(np.linalg.norm(fan, axis=1).sum() / 2)
