"""Where a toe may stand on a flat patch: away from edges and from what rises beside or above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from climbplan.robots.rotations import Array
from climbplan.scan.compiling import compiled
from climbplan.scan.raw import Index

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
    frame: Frame, own: Index, corners: Array, normals: Array, flatness: float, room: float
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


@compiled
def circles(corners: Array) -> tuple[Array, Array]:
    """Middles (T, 2) of triangles (T, 3, 3) seen along the normal, and how far corners are off."""
    middle, radius = np.empty((len(corners), 2)), np.empty(len(corners))
    for t in range(len(corners)):
        for k in range(2):
            middle[t, k] = (corners[t, 0, k] + corners[t, 1, k] + corners[t, 2, k]) / 3
        most = 0.0
        for c in range(3):
            across = corners[t, c, 0] - middle[t, 0]
            along = corners[t, c, 1] - middle[t, 1]
            most = max(most, across * across + along * along)
        radius[t] = np.sqrt(most)
    return middle, radius


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
    frame: Frame, own: Index, placed: Array, corners: Array, beside: float, below: float
) -> tuple[Index, Array, tuple[Array, Array]]:
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


@compiled
def within_box(corners: Array, lower: Array, upper: Array) -> np.ndarray:
    """(T,) whether the bounds of triangles meet a box."""
    out = np.empty(len(corners), np.bool_)
    for t in range(len(corners)):
        meets = True
        for k in range(3):
            a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
            if min(a, b, c) > upper[k] or max(a, b, c) < lower[k]:
                meets = False
                break
        out[t] = meets
    return out


@compiled
def in_frame(
    corners: Array, number: Index, origin: Array, axes: Array
) -> tuple[Array, Array, Array]:
    """Corners (K, 3, 3) of some triangles in a frame, with their least and largest (K, 3).

    The same corner of two triangles has the same digits, which a product of matrices of different
    lengths does not promise: a coverage whose edges do not match is no coverage.
    """
    out = np.empty((len(number), 3, 3))
    least, most = np.empty((len(number), 3)), np.empty((len(number), 3))
    for i in range(len(number)):
        t = number[i]
        for k in range(3):
            low, high = np.inf, -np.inf
            for c in range(3):
                value = (corners[t, c, 0] - origin[0]) * axes[k, 0]
                value += (corners[t, c, 1] - origin[1]) * axes[k, 1]
                value += (corners[t, c, 2] - origin[2]) * axes[k, 2]
                out[i, c, k] = value
                low, high = min(low, value), max(high, value)
            least[i, k], most[i, k] = low, high
    return out, least, most


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


@compiled
def clipped(corners: Array, low: float, high: float) -> tuple[Array, Index]:
    """Corners (K, 2) and their numbers of what of triangles (T, 3, 3) is between two heights."""
    points = np.empty((5 * len(corners), 2))
    counts = np.zeros(len(corners), np.int64)
    used, kept = 0, 0
    for t in range(len(corners)):
        piece = np.empty((5, 3))
        piece[:3] = corners[t]
        size = 3
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            least = low if side == 0 else -high
            after = np.empty((5, 3))
            count = 0
            for k in range(size):
                here, there = piece[k], piece[(k + 1) % size]
                a, b = sign * here[2] - least, sign * there[2] - least
                if a >= 0:
                    after[count] = here
                    count += 1
                if a * b < 0:
                    after[count] = here + a / (a - b) * (there - here)
                    count += 1
            piece, size = after, count
        if size >= 3:
            for k in range(size):
                points[used + k] = piece[k, :2]
            used += size
            counts[kept] = size
            kept += 1
    return points[:used].copy(), counts[:kept].copy()


@compiled
def buried(places: Array, directions: Array, corners: Array, far: float) -> np.ndarray:
    """(P,) whether the first surface that a ray meets within `far` [m] shows its back."""
    out = np.zeros(len(places), np.bool_)
    for p in range(len(places)):
        origin, along = places[p], directions[p]
        nearest, back = far, False
        low, high = np.empty(3), np.empty(3)
        for k in range(3):
            end = origin[k] + far * along[k]
            low[k], high[k] = min(origin[k], end), max(origin[k], end)
        for t in range(len(corners)):
            meets = True
            for k in range(3):
                a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
                if min(a, b, c) > high[k] or max(a, b, c) < low[k]:
                    meets = False
                    break
            if not meets:
                continue
            # T. Moeller and B. Trumbore (1997)
            e, f = corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0]
            px = along[1] * f[2] - along[2] * f[1]
            py = along[2] * f[0] - along[0] * f[2]
            pz = along[0] * f[1] - along[1] * f[0]
            det = e[0] * px + e[1] * py + e[2] * pz
            if abs(det) < 1e-15:
                continue
            s = origin - corners[t, 0]
            u = (s[0] * px + s[1] * py + s[2] * pz) / det
            if u < 0 or u > 1:
                continue
            qx = s[1] * e[2] - s[2] * e[1]
            qy = s[2] * e[0] - s[0] * e[2]
            qz = s[0] * e[1] - s[1] * e[0]
            v = (along[0] * qx + along[1] * qy + along[2] * qz) / det
            if v < 0 or u + v > 1:
                continue
            distance = (f[0] * qx + f[1] * qy + f[2] * qz) / det
            if 0 < distance < nearest:
                nearest, back = distance, det < 0
        out[p] = back
    return out
