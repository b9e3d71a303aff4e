"""Checks of a walk against the raw surface of its scan: stance and swings, by its triangles.

Foothold regions are a result of planning and are not used here, but for their normals: a spherical
foot touches the ground at its radius from its centre, along the normal.
"""

from __future__ import annotations

import numpy as np
import shapely

from climbplan.arrays import Array, BoolArray
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import WalkTask, WalkTrajectory

_NOWHERE = -np.inf
_UPRIGHT = 1e-12  # [m^2] level area of a triangle that is upright
_POINT = 1e-9  # [m] length of a segment that is a point
_SEARCH = 0.1  # [m] beyond the flatness, within which distances are measured


def compute_stance_error(task: WalkTask, trajectory: WalkTrajectory, scan: RawSurface) -> Array:
    """Return how far standing feet (T, L) are off the raw surface [m]; 0 for swinging ones."""
    ground, contact = task.ground, trajectory.gait.contact
    touched = _find_touched_points(ground, trajectory)
    unique, inverse = np.unique(touched[contact], axis=0, return_inverse=True)
    distance = np.zeros(contact.shape)
    distance[contact] = _measure_distances(unique, scan)[inverse.reshape(-1)]
    return distance


def compute_swing_deficit(task: WalkTask, trajectory: WalkTrajectory, scan: RawSurface) -> Array:
    """Return the height (N + 1, L) that swinging toes lack above the surface on their paths [m].

    A toe is lifted where it stood, moves level and is lowered where it lands: from knot to knot it
    has to be `swing_clearance` above the highest surface beneath the straight segment.
    """
    toes, contact = trajectory.toes, trajectory.gait.contact
    knots, legs = contact.shape
    segments, toe_of_segment = [], []
    for n in range(1, knots):
        for leg in range(legs):
            if contact[n, leg]:
                continue
            for m in (n - 1, n + 1):
                if m < knots:
                    segments.append((toes[n, leg, :2], toes[m, leg, :2]))
                    toe_of_segment.append((n, leg))
    highest = np.full(contact.shape, _NOWHERE)
    if segments:
        index = np.array(toe_of_segment)
        heights = _find_highest_surface(np.array(segments), scan)
        np.maximum.at(highest, (index[:, 0], index[:, 1]), heights)
    deficit = highest + task.swing_clearance - toes[..., 2]
    return np.where(contact | (highest == _NOWHERE), 0.0, np.maximum(deficit, 0.0))


def compute_depth(toes: Array, scan: RawSurface) -> Array:
    """Return how deep toes (..., 3) are below the highest surface above or under them [m]."""
    places = toes.reshape(-1, 3)
    segments = np.repeat(places[:, None, :2], 2, axis=1)
    depth = _find_highest_surface(segments, scan) - places[:, 2]
    return np.asarray(np.maximum(depth, 0.0).reshape(toes.shape[:-1]))


def _find_touched_points(ground: Ground, trajectory: WalkTrajectory) -> Array:
    """Return where spherical feet (T, L, 3) touch planes whose centres are on raised planes."""
    slope = ground.slope[trajectory.gait.region]
    normal = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    result: Array = trajectory.toes + ground.standoff * (np.array([0.0, 0.0, 1.0]) - normal)
    return result


def _measure_distances(points: Array, scan: RawSurface) -> Array:
    """Return distances (P,) of points (P, 3) from triangles, up to a little over the flatness."""
    reach = scan.flatness + _SEARCH
    corners = scan.corners
    low, high = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    distance = np.full(len(points), reach)
    for p, point in enumerate(points):
        candidates = corners[((low <= point) & (high >= point)).all(axis=1)]
        if len(candidates):
            distance[p] = min(reach, float(_measure_triangle_distances(point, candidates).min()))
    return distance


def _measure_triangle_distances(point: Array, corners: Array) -> Array:
    """Return distances (T,) of a point (3,) from triangles (T, 3, 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    offset = point - corners
    length = np.maximum((sides**2).sum(axis=-1), 1e-30)
    along = np.clip((offset * sides).sum(axis=-1) / length, 0.0, 1.0)
    from_sides = np.linalg.norm(offset - along[..., None] * sides, axis=-1).min(axis=1)
    normal = np.cross(sides[:, 0], sides[:, 1])
    size = np.linalg.norm(normal, axis=-1)
    unit = normal / np.maximum(size, 1e-30)[:, None]
    inside = (np.cross(sides, offset) * unit[:, None]).sum(axis=-1).min(axis=1) >= 0
    height = np.abs((offset[:, 0] * unit).sum(axis=-1))
    return np.where(inside & (size > 1e-15), height, from_sides)


def _find_highest_surface(segments: Array, scan: RawSurface) -> Array:
    """Return the highest surface (M,) beneath segments (M, 2, 2); -inf where there is none [m]."""
    corners = scan.corners
    sides = np.roll(corners, -1, axis=1) - corners
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    is_upright = np.abs(area) < _UPRIGHT
    highest = np.full(len(segments), _NOWHERE)
    shapes, owner = _build_shapes(corners, is_upright)
    is_point = np.abs(segments[:, 0] - segments[:, 1]).max(axis=1) < _POINT
    lines = np.where(is_point, shapely.points(segments[:, 0]), shapely.linestrings(segments))
    line, shape = shapely.STRtree(shapes).query(lines, predicate="intersects")
    pieces = shapely.intersection(lines[line], shapes[shape])
    points, piece = shapely.get_coordinates(pieces, return_index=True)
    if not len(points):
        return highest
    triangle = owner[shape[piece]]
    heights = _compute_heights(corners[triangle], is_upright[triangle], points)
    np.maximum.at(highest, line[piece], heights)
    return highest


def _build_shapes(corners: Array, is_upright: BoolArray) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles seen from above, upright ones as lines, and the triangle of each shape."""
    flat = np.flatnonzero(~is_upright)
    upright = np.flatnonzero(is_upright)
    polygons = shapely.polygons(corners[flat][..., :2])
    lines = shapely.linestrings(corners[upright][:, [0, 1, 2, 0], :2])
    return np.concatenate([polygons, lines]), np.concatenate([flat, upright])


def _compute_heights(corners: Array, is_upright: BoolArray, points: Array) -> Array:
    """Return heights (M,) of triangles (M, 3, 3) over points (M, 2); the highest of upright ones.

    An upright triangle is as high at a point as the higher of its sides there.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0, :2]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    safe = np.where(is_upright, 1.0, area)
    a = (offset[:, 0] * second[:, 1] - offset[:, 1] * second[:, 0]) / safe
    b = (first[:, 0] * offset[:, 1] - first[:, 1] * offset[:, 0]) / safe
    plane = corners[:, 0, 2] + a * first[:, 2] + b * second[:, 2]
    plane = np.clip(plane, corners[..., 2].min(axis=1), corners[..., 2].max(axis=1))
    sides = np.roll(corners, -1, axis=1) - corners
    along = points[:, None] - corners[..., :2]
    length = (sides[..., :2] ** 2).sum(axis=-1)
    fraction = (along * sides[..., :2]).sum(axis=-1) / np.maximum(length, 1e-30)
    is_on_side = (fraction > -1e-6) & (fraction < 1 + 1e-6) & (length > 1e-18)
    rising = corners[..., 2] + np.clip(fraction, 0.0, 1.0) * sides[..., 2]
    upright = np.where(is_on_side, rising, corners[..., 2].min(axis=1)[:, None]).max(axis=1)
    return np.where(is_upright, upright, plane)
