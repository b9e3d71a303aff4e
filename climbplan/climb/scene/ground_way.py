"""A way of the body over ground: points to pass where the straight way leads through the ground."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.scan.contact_regions import FoundRegion

_SPACING = 0.05  # [m] between the points at which the ground is measured
_GROUND_COSINE = 0.7  # smallest upward part of the normal of ground
_TOLERANCE = 0.02  # [m] that the way may leave out


def follow_ground(
    start: Array, goal: Array, regions: Sequence[FoundRegion], half_length: float
) -> Array:
    """Return points (P, 3) of a way above the ground, those of start and goal included.

    Its height above the ground, averaged over the length of the stance, changes evenly from that
    at the start to that at the goal. Without ground it is the straight way.

    Args:
        start: Body origin (3,) [m].
        goal: Body origin (3,) [m].
        regions: Contact regions.
        half_length: Half the length of the stance [m].
    """
    ground = [region for region in regions if region.normal[2] >= _GROUND_COSINE]
    length = float(np.linalg.norm((goal - start)[:2]))
    count = int(np.ceil(length / _SPACING))
    if not ground or count < 2:
        return np.stack([start, goal])
    fraction = np.linspace(0.0, 1.0, count + 1)
    points = start + fraction[:, None] * (goal - start)
    margin = int(np.ceil(half_length / _SPACING))
    beyond = np.arange(-margin, count + margin + 1)[:, None] / count
    heights = _measure_heights(start[:2] + beyond * (goal - start)[:2], ground)
    window = np.ones(2 * margin + 1) / (2 * margin + 1)
    averaged = np.convolve(heights, window, mode="valid")
    body_height = (points[0, 2] - averaged[0], points[-1, 2] - averaged[-1])
    points[:, 2] = averaged + body_height[0] + fraction * (body_height[1] - body_height[0])
    return points[_select_corners(points)]


def _measure_heights(places: Array, ground: Sequence[FoundRegion]) -> Array:
    """Return the heights (P,) of the highest ground at places (P, 2), beside it of the nearest."""
    highest = np.full(len(places), -np.inf)
    nearest, nearest_distance = np.zeros(len(places)), np.full(len(places), np.inf)
    for region in ground:
        corners = region.vertices[:, :2]
        outward = np.roll(corners, -1, axis=0) - corners
        outward = np.stack([outward[:, 1], -outward[:, 0]], axis=1)
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
        beyond = ((places[:, None] - corners) * outward).sum(axis=-1).max(axis=1)
        offset = region.normal @ region.vertices[0]
        height = (offset - places @ region.normal[:2]) / region.normal[2]
        highest = np.where(beyond <= 0, np.maximum(highest, height), highest)
        nearest = np.where(beyond < nearest_distance, height, nearest)
        nearest_distance = np.minimum(nearest_distance, beyond)
    return np.where(np.isfinite(highest), highest, nearest)


def _select_corners(points: Array) -> list[int]:
    """Return the rows of a polyline (P, 3) that stay (D. Douglas and T. Peucker, 1973)."""
    corners_so_far, open_pieces = {0, len(points) - 1}, [(0, len(points) - 1)]
    while open_pieces:
        first, last = open_pieces.pop()
        piece = points[first : last + 1]
        chord = piece[0] + np.linspace(0, 1, len(piece))[:, None] * (piece[-1] - piece[0])
        distance = np.linalg.norm(piece - chord, axis=1)
        if distance.max() > _TOLERANCE:
            middle = first + int(distance.argmax())
            corners_so_far.add(middle)
            open_pieces += [(first, middle), (middle, last)]
    return sorted(corners_so_far)
