"""Exact, vectorised distances of links (capsules) from blocks and from each other."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

_BATCH_SIZE = 8192  # segments and blocks at a time


def segment_to_block(first: Array, last: Array, lower: Array, upper: Array) -> Array:
    """Return distances (...) of segments from axis-parallel blocks [m]; 0 if they intersect.

    All arguments broadcast to (..., 3). The squared distance is convex along a segment, with a
    piecewise linear slope that breaks where coordinates pass faces of the block. A bisection finds
    the pair of breakpoints around the zero of the slope, and the minimum is exact.
    """
    shape = np.broadcast_shapes(first.shape, last.shape, lower.shape, upper.shape)
    rows = max(_BATCH_SIZE // max(int(np.prod(shape[1:-1])), 1), 1)
    if len(shape) > 1 and shape[0] > rows:
        distances = []
        for start in range(0, shape[0], rows):
            rows_of_batch = slice(start, start + rows)
            batch = (
                each[rows_of_batch] if each.ndim == len(shape) and len(each) > 1 else each
                for each in (first, last, lower, upper)
            )
            distances.append(_segment_to_block_batch(*batch))
        return np.concatenate(distances)
    return _segment_to_block_batch(first, last, lower, upper)


def _segment_to_block_batch(first: Array, last: Array, lower: Array, upper: Array) -> Array:
    """Return the distances of a batch that fits the processor cache."""
    shape = np.broadcast_shapes(first.shape, last.shape, lower.shape, upper.shape)
    span = np.broadcast_to(last - first, shape)

    def excess(parameter: Array) -> Array:
        point = first + parameter[..., None] * span
        difference: Array = point - np.minimum(np.maximum(point, lower), upper)
        return difference

    def slope(parameter: Array) -> Array:
        difference: Array = np.einsum("...i,...i->...", span, excess(parameter))
        return difference

    passing = np.where(
        span == 0, 1.0, span
    )  # coordinates that never pass a face give no breakpoint
    breakpoints = np.empty((*shape[:-1], 8))
    breakpoints[..., 0], breakpoints[..., 7] = 0.0, 1.0
    breakpoints[..., 1:4], breakpoints[..., 4:7] = (
        (lower - first) / passing,
        (upper - first) / passing,
    )
    breakpoints = np.sort(np.clip(breakpoints, 0.0, 1.0), axis=-1)
    low, high = np.zeros(shape[:-1], int), np.full(shape[:-1], 7)
    for _ in range(3):
        middle = (low + high) // 2
        falls = slope(np.take_along_axis(breakpoints, middle[..., None], axis=-1)[..., 0]) <= 0
        low, high = np.where(falls, middle, low), np.where(falls, high, middle)
    begin = np.take_along_axis(breakpoints, low[..., None], axis=-1)[..., 0]
    end = np.take_along_axis(breakpoints, high[..., None], axis=-1)[..., 0]
    at_begin, at_end = slope(begin), slope(end)
    increase = at_end - at_begin
    parameter = begin - at_begin * (end - begin) / np.where(increase > 0, increase, 1.0)
    offset = excess(np.minimum(np.maximum(parameter, begin), end))
    distance: Array = np.sqrt(np.einsum("...i,...i->...", offset, offset))
    return distance


def segment_to_segment(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Return distances (...) between segments [m]; all arguments broadcast to (..., 3).

    The closest points are those of Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    det = uu * vv - uv**2
    safe = np.where(det > 1e-12, det, 1.0)
    s = np.where(det > 1e-12, np.clip((uv * vw - vv * uw) / safe, 0, 1), 0.0)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-12), 0, 1)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-12), 0, 1)
    distance: Array = np.sqrt(((w + s[..., None] * u - t[..., None] * v) ** 2).sum(-1))
    return distance


def block_gap(centre: Array, half: Array, lower: Array, upper: Array) -> Array:
    """Return signed gaps (...) between axis-parallel blocks along their best axis [m]."""
    gap: Array = np.maximum(lower - (centre + half), (centre - half) - upper).max(axis=-1)
    return gap


def upright_gap(
    centre: Array, yaw: Array, half: Array, other_centre: Array, other_yaw: Array, other_half: Array
) -> Array:
    """Return signed gaps (...) between upright blocks along their best separating axis [m].

    Blocks have centres (..., 3), yaws (...) about the vertical and half edges (3,). The best axis
    of convex outlines is a normal of one of their edges (separating axis theorem), so the sign is
    exact.
    """
    offset = other_centre - centre
    gaps = [np.abs(offset[..., 2]) - half[2] - other_half[2]]
    for face_yaw in (yaw, other_yaw):
        for axis in (face_yaw, face_yaw + np.pi / 2):
            distance = np.abs(offset[..., 0] * np.cos(axis) + offset[..., 1] * np.sin(axis))
            half_widths = [
                h[0] * np.abs(np.cos(y - axis)) + h[1] * np.abs(np.sin(y - axis))
                for h, y in ((half, yaw), (other_half, other_yaw))
            ]
            gaps.append(distance - half_widths[0] - half_widths[1])
    gap: Array = np.max(gaps, axis=0)
    return gap
