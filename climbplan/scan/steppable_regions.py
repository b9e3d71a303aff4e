"""Steppable area of a flat patch: away from edges and from obstacles next to it or above it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from climbplan.arrays import Array, IntArray
from climbplan.scan.triangles import (
    clip_to_heights,
    compute_bounding_circles,
    find_within_box,
    transform_to_frame,
)

HEADROOM = 0.05  # [m] of free space before a region: the thickness of a limb at its toe
_MIN_FACING = 0.5  # cosine to a patch's normal of what continues its surface
_MAX_SLOPE = 0.7  # by which that may leave the plane, some 35 degrees
_CRACK = 2e-6  # [m] half width of gaps that are ignored
_ARC_SEGMENTS = 4  # of a quarter circle
_SPHERE_LAYERS = 4  # of cylinders about the lower half of a spherical foot
_SPHERE_CONTACT = 1e-3  # [m] above a patch that spherical feet may touch beside where they stand
_CIRCUMSCRIBED = 1.0 / np.cos(np.pi / (4 * _ARC_SEGMENTS))  # polygons contain their circles


@dataclass(frozen=True)
class PlaneFrame:
    """A plane with axes: x = origin + u across + v along + height normal."""

    origin: Array  # (3,) on the plane
    across: Array  # (3,)
    along: Array  # (3,)
    normal: Array  # (3,)

    @classmethod
    def on(cls, normal: Array, offset: float) -> PlaneFrame:
        """Return the frame of a plane, with axes that depend on the plane alone."""
        across = np.cross(np.eye(3)[int(np.argmin(np.abs(normal) - 1e-9 * np.arange(3)))], normal)
        across /= np.linalg.norm(across)
        return cls(offset * normal, across, np.cross(normal, across), normal)

    @property
    def axes(self) -> Array:
        """Axes (3, 3) with a row each of u, v and height."""
        return np.stack([self.across, self.along, self.normal])

    def to_local(self, points: Array) -> Array:
        """Return points (..., 3) as u, v and height."""
        return (points - self.origin) @ self.axes.T

    def world(self, points: Array) -> Array:
        """Return points (..., 2) of the plane in the world."""
        return self.origin + points[..., :1] * self.across + points[..., 1:] * self.along


@dataclass(frozen=True)
class ToeClearance:
    """Distances that toes keep from edges and from what rises [m]."""

    flatness: float  # distance of a patch's triangles from its plane
    distance: float  # about the toe
    foot_radius: float = 0.0  # of spherical feet; 0 for points


def compute_steppable_area(
    frame: PlaneFrame,
    patch_triangles: IntArray,
    corners: Array,
    normals: Array,
    required: ToeClearance,
) -> shapely.Geometry:
    """Compute the part of a patch on which a toe has a clearance, as a polygon of its frame.

    Within the clearance the surface continues, in whatever triangles, and nothing rises next to the
    toe or above it. A spherical foot that rests on the plane meets no other triangle.

    Args:
        frame: The plane of the patch.
        patch_triangles: The patch's triangles.
        corners: Of the whole scan (T, 3, 3) [m].
        normals: Of the whole scan (T, 3).
        required: What toes keep from edges, and from what rises.
    """
    clearance = required.distance
    placed = transform_to_frame(corners, patch_triangles, frame.origin, frame.axes)[0]
    patch = _join_triangles(_build_polygons(placed[..., :2]))
    if patch.is_empty:
        return patch
    shapely.prepare(patch)
    limit = required.flatness + _MAX_SLOPE * clearance
    neighbours, heights, reach = _find_nearby_triangles(
        frame, patch_triangles, placed, corners, 2 * clearance + 1e-6, limit
    )
    lowest, highest = reach
    facing = normals[neighbours] @ frame.normal > _MIN_FACING
    level = facing & (highest >= -limit) & (lowest <= limit)
    outline = _Outline.of(patch, max(clearance, 1e-3))
    level[level] = _find_near_outline(heights[level], outline, 2 * clearance)
    free = patch
    if clearance > 0:
        ground = _extend_ground(patch, heights[level], limit)
        # Cracks between triangles that share no corners in the file are no edges
        edges = shapely.boundary(shapely.buffer(ground, _CRACK, join_style="mitre"))
        edges = shapely.intersection(edges, shapely.box(*_extend_bounds(patch, 2 * clearance)))
        free = shapely.difference(
            free, shapely.buffer(edges, _CIRCUMSCRIBED * clearance, quad_segs=_ARC_SEGMENTS)
        )
    layers = [_Layer(limit, HEADROOM, clearance)]
    if required.foot_radius > 0:
        lowest_contact = max(float(placed[..., 2].max()), 0.0) + _SPHERE_CONTACT
        layers += _list_sphere_layers(required.foot_radius, lowest_contact, limit)
    for layer in layers:
        rising = heights[(highest >= layer.low) & (lowest <= layer.high)]
        free = _keep_off(free, patch, outline, rising, layer)
    return free


def _extend_ground(patch: shapely.Geometry, corners: Array, limit: float) -> shapely.Geometry:
    """Return a patch with what of triangles (T, 3, 3) continues it within a height [m]."""
    is_whole = (np.abs(corners[..., 2]) <= limit).all(axis=1)
    ground = patch
    if is_whole.any():
        ground = _join_triangles([patch, *_build_polygons(corners[is_whole][..., :2])])
    cut = _clip_polygons(corners[~is_whole], -limit, limit)
    return _unite([ground, *cut]) if cut else ground


@dataclass(frozen=True)
class _Layer:
    """Heights over a plane, and the distance to keep along the plane from what is there [m]."""

    low: float
    high: float
    clearance: float


def _list_sphere_layers(radius: float, low: float, high: float) -> list[_Layer]:
    """Return layers of heights, from low to high, as wide as a sphere on the plane is there."""
    levels = np.linspace(low, max(radius, low), _SPHERE_LAYERS + 1)
    levels = np.unique(np.minimum(np.append(levels, high), high))
    below_centre = np.clip(radius - levels[1:], 0.0, radius)
    widths = np.sqrt(radius**2 - below_centre**2)
    return [
        _Layer(below, above, width)
        for (below, above), width in zip(itertools.pairwise(levels), widths, strict=True)
    ]


def _keep_off(
    free: shapely.Geometry,
    patch: shapely.Geometry,
    outline: _Outline,
    corners: Array,
    layer: _Layer,
) -> shapely.Geometry:
    """Return what of a free area keeps off triangles (T, 3, 3) in a layer over a patch."""
    clearance = layer.clearance
    is_above = shapely.contains_xy(patch, corners[..., :2].mean(axis=1)) if len(corners) else []
    corners = corners[_find_near_outline(corners, outline, clearance) | np.asarray(is_above, bool)]
    blocking = _clip_polygons(corners, layer.low, layer.high)
    if blocking:
        around = np.array(blocking, object)
        around = around[shapely.dwithin(around, patch, clearance)]
        around = shapely.buffer(
            around, _CIRCUMSCRIBED * max(clearance, 1e-4), quad_segs=_ARC_SEGMENTS
        )
        free = shapely.difference(free, shapely.union_all(around))
    return free


def _find_near_outline(corners: Array, outline: _Outline, distance_limit: float) -> np.ndarray:
    """Return the triangles (T,) that may come within a distance of an outline, along the normal."""
    if not len(corners):
        return np.zeros(0, bool)
    middle, radius = compute_bounding_circles(corners)
    # Distances beyond the reach of the largest triangle are not needed
    max_distance = distance_limit + float(radius.max()) + outline.spacing
    distance = outline.points.query(middle, distance_upper_bound=max_distance * (1 + 1e-9))[0]
    return np.asarray(distance <= distance_limit + radius + outline.spacing)


@dataclass(frozen=True)
class _Outline:
    """Points along the border of a polygon."""

    points: cKDTree
    spacing: float  # [m]

    @classmethod
    def of(cls, polygon: shapely.Geometry, spacing: float) -> _Outline:
        """Return points along the border of a polygon with this spacing [m]."""
        rim = shapely.segmentize(shapely.boundary(polygon), spacing)
        return cls(cKDTree(shapely.get_coordinates(rim)), spacing)


def _unite(polygons: list[shapely.Geometry]) -> shapely.Geometry:
    """Return any polygons and lines as one."""
    return shapely.union_all(np.array(polygons, object))


def _join_triangles(polygons: list[shapely.Geometry]) -> shapely.Geometry:
    """Return triangles, or unions of some, as one polygon.

    Without overlaps, common edges suffice.
    """
    shapes = np.array(polygons, object)
    whole = shapes[shapely.area(shapes) > 1e-14]
    if len(whole) > 8:
        try:
            union = shapely.coverage_union_all(whole)
        except shapely.errors.GEOSException:
            return _unite(polygons)
        area = float(shapely.area(whole).sum())
        if shapely.is_valid(union) and abs(union.area - area) <= 1e-9 * max(area, 1e-6):
            return union
    return _unite(polygons)


def _build_polygons(corners: Array) -> list[shapely.Geometry]:
    """Return triangles (T, 3, 2) as polygons."""
    return list(shapely.polygons(corners))


def _extend_bounds(polygon: shapely.Geometry, by: float) -> tuple[float, float, float, float]:
    """Return the bounds of a polygon, extended on all sides [m]."""
    a, b, c, d = polygon.bounds
    return a - by, b - by, c + by, d + by


def _find_nearby_triangles(
    frame: PlaneFrame,
    patch_triangles: IntArray,
    placed: Array,
    corners: Array,
    lateral: float,
    depth: float,
) -> tuple[IntArray, Array, tuple[Array, Array]]:
    """Return other triangles that may reach into the box over a patch, up to the headroom.

    placed (P, 3, 3): corners of the patch's own triangles in its frame. Returns numbers (K,),
    corners
    (K, 3, 3) in that frame, and the lowest and highest heights (K,) of these.
    """
    places = placed.reshape(-1, 3)
    low, high = places.min(axis=0) - lateral, places.max(axis=0) + lateral
    low[2], high[2] = -depth, max(HEADROOM, depth)
    ends = np.stack([low, high])
    box = np.array(
        [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    around = frame.world(box[:, :2]) + box[:, 2:] * frame.normal
    is_inside = find_within_box(corners, around.min(axis=0), around.max(axis=0))
    is_inside[patch_triangles] = False
    number = np.flatnonzero(is_inside)
    heights, lowest, highest = transform_to_frame(corners, number, frame.origin, frame.axes)
    meets = (lowest <= high).all(axis=1) & (highest >= low).all(axis=1)
    return number[meets], heights[meets], (lowest[meets, 2], highest[meets, 2])


def _clip_polygons(corners: Array, low: float, high: float) -> list[shapely.Geometry]:
    """Return what of triangles (T, 3, 3) lies between two heights, seen along the normal."""
    lowest, highest = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    inside = (lowest >= low) & (highest <= high)
    cut = ~inside & (highest >= low) & (lowest <= high)
    polygons = _build_polygons(corners[inside][..., :2])
    if cut.any():
        points, counts = clip_to_heights(corners[cut], low, high)
        number = np.repeat(np.arange(len(counts)), counts)
        rings = shapely.linearrings(points, indices=number)
        polygons += list(shapely.polygons(rings))
    size = shapely.area(np.array(polygons, object))
    return [
        p if area > 1e-14 else _flatten_polygon(p) for p, area in zip(polygons, size, strict=True)
    ]


def _flatten_polygon(polygon: shapely.Geometry) -> shapely.Geometry:
    """Return a polygon without area as the line that it is."""
    points = shapely.get_coordinates(polygon)
    spread = points - points[0]
    along = spread[int(np.argmax((spread**2).sum(axis=1)))]
    projection = spread @ along
    return shapely.LineString(points[[int(np.argmin(projection)), int(np.argmax(projection))]])
