"""Where a toe may stand on a flat patch: away from edges and from what rises beside or above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from climbplan.arrays import Array, IntArray
from climbplan.scan.triangles import circles, clipped, in_frame, within_box

HEADROOM = 0.05  # [m] before a region that has to be free: a limb is as thick as that at its toe
_FACING = 0.5  # cosine to a patch's normal of what carries on its surface
_SLOPE = 0.7  # of toe radii: how far that may leave the plane, a turn of some 35 degrees
_CRACK = 2e-6  # [m] gaps up to twice as wide are none
_ARC = 4  # pieces of a quarter circle
_ROUND = 1.0 / np.cos(np.pi / (4 * _ARC))  # so that polygons contain their circles


@dataclass(frozen=True)
class Frame:
    """A plane with axes: x = origin + u across + v along + height normal."""

    origin: Array  # (3,) on the plane
    across: Array  # (3,)
    along: Array  # (3,)
    normal: Array  # (3,)

    @classmethod
    def on(cls, normal: Array, offset: float) -> Frame:
        """Axes that depend on the plane alone."""
        across = np.cross(np.eye(3)[int(np.argmin(np.abs(normal) - 1e-9 * np.arange(3)))], normal)
        across /= np.linalg.norm(across)
        return cls(offset * normal, across, np.cross(normal, across), normal)

    @property
    def axes(self) -> Array:
        """(3, 3) with a row each of u, v and height."""
        return np.stack([self.across, self.along, self.normal])

    def own(self, points: Array) -> Array:
        """Points (..., 3) as u, v and height."""
        return (points - self.origin) @ self.axes.T

    def world(self, points: Array) -> Array:
        """Points (..., 2) of the plane in the world."""
        return self.origin + points[..., :1] * self.across + points[..., 1:] * self.along


def standable(
    frame: Frame, own: IntArray, corners: Array, normals: Array, flatness: float, room: float
) -> shapely.Geometry:
    """The part of a patch, as a polygon of its frame, on which a toe has `room` [m] around it.

    own: the patch's triangles; corners (T, 3, 3), normals (T, 3): of the whole scan. Within `room`
    the surface goes on, in whatever triangles, and nothing rises beside or above.
    """
    placed = in_frame(corners, own, frame.origin, frame.axes)[0]
    patch = _joined(_polygons(placed[..., :2]))
    if patch.is_empty:
        return patch
    shapely.prepare(patch)
    limit = flatness + _SLOPE * room
    near, heights, reach = _near(frame, own, placed, corners, 2 * room + 1e-6, limit)
    low, high = reach
    facing = normals[near] @ frame.normal > _FACING
    level = facing & (high >= -limit) & (low <= limit)
    outline = _Outline.of(patch, max(room, 1e-3))
    level[level] = _beside(heights[level], outline, 2 * room)
    whole = level & (high <= limit) & (low >= -limit)
    ground = _joined([patch, *_polygons(heights[whole][..., :2])]) if whole.any() else patch
    cut = _polygons_within(heights[level & ~whole], -limit, limit)
    if cut:
        ground = _union([ground, *cut])
    free = patch
    if room > 0:
        # Cracks between triangles that are no neighbours in the file are no edges
        edges = shapely.boundary(shapely.buffer(ground, _CRACK, join_style="mitre"))
        edges = shapely.intersection(edges, shapely.box(*_grown_bounds(patch, 2 * room)))
        free = shapely.difference(free, shapely.buffer(edges, _ROUND * room, quad_segs=_ARC))
    rising = heights[(high >= limit) & (low <= HEADROOM)]
    over = shapely.contains_xy(patch, rising[..., :2].mean(axis=1)) if len(rising) else []
    rising = rising[_beside(rising, outline, room) | np.asarray(over, bool)]
    blocking = _polygons_within(rising, limit, HEADROOM)
    if blocking:
        around = np.array(blocking, object)
        around = around[shapely.dwithin(around, patch, room)]
        around = shapely.buffer(around, _ROUND * max(room, 1e-4), quad_segs=_ARC)
        free = shapely.difference(free, shapely.union_all(around))
    return free


def _beside(corners: Array, outline: _Outline, by: float) -> np.ndarray:
    """(T,) triangles, seen along the normal, that may come within a distance of an outline."""
    if not len(corners):
        return np.zeros(0, bool)
    middle, radius = circles(corners)
    # Farther off than the largest triangle may come is not measured
    most = by + float(radius.max()) + outline.spacing
    away = outline.points.query(middle, distance_upper_bound=most * (1 + 1e-9))[0]
    return np.asarray(away <= by + radius + outline.spacing)


@dataclass(frozen=True)
class _Outline:
    """Points along the border of a polygon."""

    points: cKDTree
    spacing: float  # [m]

    @classmethod
    def of(cls, polygon: shapely.Geometry, spacing: float) -> _Outline:
        rim = shapely.segmentize(shapely.boundary(polygon), spacing)
        return cls(cKDTree(shapely.get_coordinates(rim)), spacing)


def _union(polygons: list[shapely.Geometry]) -> shapely.Geometry:
    """Any polygons and lines as one."""
    return shapely.union_all(np.array(polygons, object))


def _joined(polygons: list[shapely.Geometry]) -> shapely.Geometry:
    """Triangles, or what was joined of some, as one polygon.

    By their common edges alone, where they do not overlap.
    """
    shapes = np.array(polygons, object)
    whole = shapes[shapely.area(shapes) > 1e-14]
    if len(whole) > 8:
        try:
            joined = shapely.coverage_union_all(whole)
        except shapely.errors.GEOSException:
            return _union(polygons)
        area = float(shapely.area(whole).sum())
        if shapely.is_valid(joined) and abs(joined.area - area) <= 1e-9 * max(area, 1e-6):
            return joined
    return _union(polygons)


def _polygons(corners: Array) -> list[shapely.Geometry]:
    return list(shapely.polygons(corners))


def _grown_bounds(polygon: shapely.Geometry, by: float) -> tuple[float, float, float, float]:
    a, b, c, d = polygon.bounds
    return a - by, b - by, c + by, d + by


def _near(
    frame: Frame, own: IntArray, placed: Array, corners: Array, beside: float, below: float
) -> tuple[IntArray, Array, tuple[Array, Array]]:
    """Other triangles that may reach into the box over a patch, up to the headroom.

    placed (P, 3, 3): corners of the patch's own triangles in its frame. Returns numbers (K,),
    corners (K, 3, 3) in that frame, and the lowest and highest of these.
    """
    places = placed.reshape(-1, 3)
    low, high = places.min(axis=0) - beside, places.max(axis=0) + beside
    low[2], high[2] = -below, max(HEADROOM, below)
    ends = np.stack([low, high])
    box = np.array(
        [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    around = frame.world(box[:, :2]) + box[:, 2:] * frame.normal
    found = within_box(corners, around.min(axis=0), around.max(axis=0))
    found[own] = False
    number = np.flatnonzero(found)
    heights, least, most = in_frame(corners, number, frame.origin, frame.axes)
    meets = (least <= high).all(axis=1) & (most >= low).all(axis=1)
    return number[meets], heights[meets], (least[meets, 2], most[meets, 2])


def _polygons_within(corners: Array, low: float, high: float) -> list[shapely.Geometry]:
    """What of triangles (T, 3, 3) lies between two heights, seen along the normal."""
    least, most = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    inside = (least >= low) & (most <= high)
    cut = ~inside & (most >= low) & (least <= high)
    out = _polygons(corners[inside][..., :2])
    if cut.any():
        points, counts = clipped(corners[cut], low, high)
        number = np.repeat(np.arange(len(counts)), counts)
        rings = shapely.linearrings(points, indices=number)
        out += list(shapely.polygons(rings))
    size = shapely.area(np.array(out, object))
    return [p if area > 1e-14 else _flat(p) for p, area in zip(out, size, strict=True)]


def _flat(polygon: shapely.Geometry) -> shapely.Geometry:
    """A polygon seen from its edge, as the line that it is."""
    points = shapely.get_coordinates(polygon)
    spread = points - points[0]
    along = spread[int(np.argmax((spread**2).sum(axis=1)))]
    share = spread @ along
    return shapely.LineString(points[[int(np.argmin(share)), int(np.argmax(share))]])
