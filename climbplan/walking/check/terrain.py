"""The terrain of the exact check: its own geometry, from outlines and planes alone."""

from __future__ import annotations

import numpy as np
import shapely

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.task.ground import Ground

_NOWHERE = -np.inf
_ROUNDING = 1e-9  # [m]


def list_outlines(ground: Ground) -> list[Array]:
    """Return the corners (C, 2) of each region, counterclockwise."""
    if ground.corners.shape[1]:
        return [np.asarray(corners) for corners in ground.corners]
    (x0, y0), (x1, y1) = ground.lower.T, ground.upper.T
    return list(np.stack([np.stack(c, -1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1))


def compute_plane_height(ground: Ground, region: IntArray, xy: Array) -> Array:
    """Return the height (...) of the planes of regions (...) at points (..., 2) [m]."""
    center = np.array([corners.mean(axis=0) for corners in list_outlines(ground)])
    offset = xy - center[region]
    rise = ground.slope[region]
    result: Array = (
        ground.height[region] + rise[..., 0] * offset[..., 0] + rise[..., 1] * offset[..., 1]
    )
    return result


def compute_region_error(
    ground: Ground, region: IntArray, toes: Array, is_given: BoolArray
) -> Array:
    """Return how far toes are off the pieces of planes that are their regions [m].

    Args:
        ground: The regions.
        region: Region of each toe (...).
        toes: Toes (..., 3) [m]; the last axis but one is the legs'.
        is_given: Toes (...) whose place is given: the strips along edges count as well.
    """
    xy = toes[..., :2]
    height_error = np.abs(toes[..., 2] - compute_plane_height(ground, region, xy))
    corners = np.array(list_outlines(ground))[region]  # (..., C, 2)
    side = np.roll(corners, -1, axis=-2) - corners
    offset = xy[..., None, :] - corners
    length = np.hypot(side[..., 0], side[..., 1])
    cross = side[..., 0] * offset[..., 1] - side[..., 1] * offset[..., 0]  # below zero: outside
    outside = np.where(length > 1e-9, -cross / np.maximum(length, 1e-9), -np.inf).max(axis=-1)
    result: Array = np.maximum(height_error, outside + np.where(is_given, 0.0, ground.edge))
    if ground.allowed.size:  # by region and leg
        result = np.where(ground.allowed[region, np.arange(region.shape[-1])], result, np.inf)
    return result


def compute_ground_height(ground: Ground, xy: Array) -> Array:
    """Return the highest ground (...) at points (..., 2) [m]; -inf where there is none."""
    highest = np.full(xy.shape[:-1], _NOWHERE)
    for region, corners in enumerate(list_outlines(ground)):
        side = np.roll(corners, -1, axis=0) - corners
        offset = xy[..., None, :] - corners
        cross = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]  # below zero: outside
        height = compute_plane_height(ground, np.full(xy.shape[:-1], region), xy)
        inside = (cross >= -1e-12).all(axis=-1)
        highest = np.where(inside, np.maximum(highest, height), highest)
    return highest


def split_force(ground: Ground, region: IntArray, force: Array) -> tuple[Array, Array]:
    """Split forces (..., 3) into normal and tangential size at their regions (...) [N]."""
    slope = ground.slope[region]
    normal = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    normal_force: Array = (force * normal).sum(axis=-1)
    tangential_force: Array = np.linalg.norm(force - normal_force[..., None] * normal, axis=-1)
    return normal_force, tangential_force


def compute_clearance_height(ground: Ground, toes: Array, contact: BoolArray) -> Array:
    """Return the ground (N + 1, L) that swinging toes have to be lifted above [m].

    It is the highest ground under the straight segments to the toe at the knots before and after,
    and where the toe lands: lifting, moving level and lowering is then clear. Standing toes have
    -inf.

    Args:
        ground: The regions.
        toes: Toes (N + 1, L, 3) [m].
        contact: Contacts (N + 1, L).
    """
    knots, legs = contact.shape
    required = np.full((knots, legs), _NOWHERE)
    segments, toe_of_segment = [], []
    for n in range(1, knots):
        for leg in np.flatnonzero(~contact[n]):
            landing_offsets = np.flatnonzero(contact[n:, leg])
            if len(landing_offsets):
                required[n, leg] = toes[n + landing_offsets[0], leg, 2]
            for m in (n - 1, n + 1):
                if m < knots:
                    segments.append((toes[n, leg, :2], toes[m, leg, :2]))
                    toe_of_segment.append((n, leg))
    if not segments:
        return required
    lines = shapely.linestrings(np.array(segments))
    # Rounding must not put a toe at an edge outside of its region
    rings = [
        shapely.linearrings(_remove_duplicate_corners(corners)) for corners in list_outlines(ground)
    ]
    shapes = shapely.buffer(shapely.polygons(rings), _ROUNDING, join_style="mitre")
    line, shape = shapely.STRtree(shapes).query(lines)
    pieces = shapely.intersection(lines[line], shapes[shape])
    points, piece = shapely.get_coordinates(pieces, return_index=True)
    if len(points):
        level = compute_plane_height(ground, shape[piece], points)
        knot, leg_of = np.array(toe_of_segment)[line[piece]].T
        np.maximum.at(required, (knot, leg_of), level)
    return required


def _remove_duplicate_corners(corners: Array) -> Array:
    """Return the corners without repeated ones."""
    is_distinct = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) > 1e-9
    return corners[is_distinct]
