"""The ground as plans are judged on it: own geometry, from outlines and planes alone."""

from __future__ import annotations

import numpy as np
import shapely

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.task.ground import Ground

_NOWHERE = -np.inf
_ROUNDING = 1e-9  # [m]


def outlines(ground: Ground) -> list[Array]:
    """Corners (C, 2) of each region, counterclockwise."""
    if ground.corners.shape[1]:
        return [np.asarray(corners) for corners in ground.corners]
    (x0, y0), (x1, y1) = ground.lower.T, ground.upper.T
    return list(np.stack([np.stack(c, -1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1))


def plane_height(ground: Ground, region: IntArray, xy: Array) -> Array:
    """Height (...) of the planes of regions (...) at points (..., 2) [m]."""
    known = np.array([corners.mean(axis=0) for corners in outlines(ground)])
    away = xy - known[region]
    rise = ground.slope[region]
    result: Array = (
        ground.height[region] + rise[..., 0] * away[..., 0] + rise[..., 1] * away[..., 1]
    )
    return result


def off_region(ground: Ground, region: IntArray, toes: Array, given: BoolArray) -> Array:
    """How far toes (..., 3) are off the pieces of planes that are their regions (...) [m].

    given (...): toes that nobody set down, for which the strips along edges count as well.
    """
    xy = toes[..., :2]
    off = np.abs(toes[..., 2] - plane_height(ground, region, xy))
    corners = np.array(outlines(ground))[region]  # (..., C, 2)
    along = np.roll(corners, -1, axis=-2) - corners
    away = xy[..., None, :] - corners
    length = np.hypot(along[..., 0], along[..., 1])
    turned = along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0]  # below zero: outside
    past = np.where(length > 1e-9, -turned / np.maximum(length, 1e-9), -np.inf).max(axis=-1)
    result: Array = np.maximum(off, past + np.where(given, 0.0, ground.edge))
    return result


def ground_at(ground: Ground, xy: Array) -> Array:
    """Height (...) of the ground at points (..., 2) [m], the highest of several; else -inf."""
    highest = np.full(xy.shape[:-1], _NOWHERE)
    for region, corners in enumerate(outlines(ground)):
        along = np.roll(corners, -1, axis=0) - corners
        away = xy[..., None, :] - corners
        turned = along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0]  # below zero: outside
        level = plane_height(ground, np.full(xy.shape[:-1], region), xy)
        inside = (turned >= -1e-12).all(axis=-1)
        highest = np.where(inside, np.maximum(highest, level), highest)
    return highest


def normal_and_sideways(ground: Ground, region: IntArray, force: Array) -> tuple[Array, Array]:
    """Parts of forces (..., 3) along the normals of regions (...) and across them [N]."""
    rise = ground.slope[region]
    normal = np.concatenate([-rise, np.ones((*rise.shape[:-1], 1))], axis=-1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    pressed: Array = (force * normal).sum(axis=-1)
    across: Array = np.linalg.norm(force - pressed[..., None] * normal, axis=-1)
    return pressed, across


def to_clear(ground: Ground, toes: Array, contact: BoolArray) -> Array:
    """Ground (N + 1, L) that swinging toes (N + 1, L, 3) have to be lifted above [m].

    The highest beneath the straight ways from the knot before and to the next one, and where the
    toe comes down: up, level across, and down is then clear. Of standing toes nothing.
    """
    knots, legs = contact.shape
    needed = np.full((knots, legs), _NOWHERE)
    ways, owners = [], []
    for n in range(1, knots):
        for leg in np.flatnonzero(~contact[n]):
            after = np.flatnonzero(contact[n:, leg])
            if len(after):
                needed[n, leg] = toes[n + after[0], leg, 2]
            for m in (n - 1, n + 1):
                if m < knots:
                    ways.append((toes[n, leg, :2], toes[m, leg, :2]))
                    owners.append((n, leg))
    if not ways:
        return needed
    lines = shapely.linestrings(np.array(ways))
    # A toe that stands at an edge, but for rounding, leaves the ground that it stands on
    rings = [_ring(corners) for corners in outlines(ground)]
    shapes = shapely.buffer(shapely.polygons(rings), _ROUNDING, join_style="mitre")
    line, shape = shapely.STRtree(shapes).query(lines)
    pieces = shapely.intersection(lines[line], shapes[shape])
    points, piece = shapely.get_coordinates(pieces, return_index=True)
    if len(points):
        level = plane_height(ground, shape[piece], points)
        knot, leg_of = np.array(owners)[line[piece]].T
        np.maximum.at(needed, (knot, leg_of), level)
    return needed


def _ring(corners: Array) -> Array:
    apart = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) > 1e-9
    return corners[apart]
