"""Distances of modules from solids, boxes and each other, for planning and for the checker.

A link is a capsule: a segment with the module's radius. The end links stop one radius short of the
latch, so a module that stands on the ground or sits in an anchor exactly touches.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.distances import segment_to_block, segment_to_segment
from climbplan.limms.scene.limms_scene import Points

LINKS = ((0, 2), (2, 3), (3, 5), (5, 7))  # straight pieces between the points of a module
_OWN_PAIRS = ((0, 2), (0, 3), (1, 3))  # pairs that do not share a joint


def link_segments(points: Points, radius: float) -> Array:
    """Return segments (..., 4, 2, 3) of modules [m]; the end ones are shortened by the radius."""
    p = points.position
    first = p[..., 0, :] + radius * points.rotation[..., 0, :, 2]
    last = p[..., 7, :] - radius * points.rotation[..., 7, :, 2]
    ends = [(first, p[..., 2, :]), (p[..., 2, :], p[..., 3, :])]
    ends += [(p[..., 3, :], p[..., 5, :]), (p[..., 5, :], last)]
    return np.stack([np.stack(pair, axis=-2) for pair in ends], axis=-3)


def gap_to_blocks(segments: Array, lower: Array, upper: Array, radius: float) -> Array:
    """Return gaps (..., 4, S) of links (..., 4, 2, 3) from blocks (S, 3) or (..., S, 3) [m]."""
    low = lower if lower.ndim == 2 else lower[..., None, :, :]
    high = upper if upper.ndim == 2 else upper[..., None, :, :]
    gap: Array = (
        segment_to_block(segments[..., 0, None, :], segments[..., 1, None, :], low, high) - radius
    )
    return gap


def gap_to_boxes(segments: Array, centre: Array, yaw: Array, half: Array, radius: float) -> Array:
    """Return gaps (..., 4, B) of links (..., 4, 2, 3) from upright boxes [m].

    Args:
        segments: Segments of links (..., 4, 2, 3) [m].
        centre: Centres of the boxes (..., B, 3) [m].
        yaw: Yaws of the boxes (..., B) [rad].
        half: Half edges of the boxes (B, 3) [m].
        radius: Radius of the links [m].
    """
    if not yaw.any():
        return gap_to_blocks(segments, centre - half, centre + half, radius)
    c, s = np.cos(yaw)[..., None, :, None], np.sin(yaw)[..., None, :, None]
    offsets = segments[..., None, :, :] - centre[..., None, :, None, :]  # (..., 4, B, 2, 3)
    x, y = c * offsets[..., 0] + s * offsets[..., 1], c * offsets[..., 1] - s * offsets[..., 0]
    local = np.stack([x, y, offsets[..., 2]], axis=-1)  # in the boxes' frames
    gap: Array = segment_to_block(local[..., 0, :], local[..., 1, :], -half, half) - radius
    return gap


def gap_between(first: Array, second: Array, radius: float) -> Array:
    """Return gaps (..., 4, 4) between the links of two modules [m]."""
    a, b = first[..., :, None, :, :], second[..., None, :, :, :]
    gap: Array = (
        segment_to_segment(a[..., 0, :], a[..., 1, :], b[..., 0, :], b[..., 1, :]) - 2 * radius
    )
    return gap


def gap_within(segments: Array, radius: float) -> Array:
    """Return gaps (..., 3) between links of one module that share no joint [m]."""
    pairs = [
        segment_to_segment(
            segments[..., i, 0, :],
            segments[..., i, 1, :],
            segments[..., j, 0, :],
            segments[..., j, 1, :],
        )
        for i, j in _OWN_PAIRS
    ]
    gap: Array = np.stack(pairs, axis=-1) - 2 * radius
    return gap
