"""Exact distances of links (segments with a radius) from blocks and from each other, vectorised."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

_MOST = 8192  # segments and blocks at a time


def segment_to_block(first: Array, last: Array, lower: Array, upper: Array) -> Array:
    """Distance (...) of segments from axis-parallel blocks [m]; 0 if they touch or are inside.

    All arguments broadcast to (..., 3). The squared distance is convex along a segment, and its
    slope a straight line between the places where coordinates pass faces of the block: the pair
    of them between which it is zero is searched for, and the place is exact.
    """
    shape = np.broadcast_shapes(first.shape, last.shape, lower.shape, upper.shape)
    rows = max(_MOST // max(int(np.prod(shape[1:-1])), 1), 1)
    if len(shape) > 1 and shape[0] > rows:
        parts = []
        for begin in range(0, shape[0], rows):
            some = slice(begin, begin + rows)
            own = (
                each[some] if each.ndim == len(shape) and len(each) > 1 else each
                for each in (first, last, lower, upper)
            )
            parts.append(_near_to_block(*own))
        return np.concatenate(parts)
    return _near_to_block(first, last, lower, upper)


def _near_to_block(first: Array, last: Array, lower: Array, upper: Array) -> Array:
    """The same of as many as the processor keeps at hand."""
    shape = np.broadcast_shapes(first.shape, last.shape, lower.shape, upper.shape)
    span = np.broadcast_to(last - first, shape)

    def excess(share: Array) -> Array:
        point = first + share[..., None] * span
        found: Array = point - np.minimum(np.maximum(point, lower), upper)
        return found

    def slope(share: Array) -> Array:
        found: Array = np.einsum("...i,...i->...", span, excess(share))
        return found

    passing = np.where(span == 0, 1.0, span)  # what never passes a face is no place to look at
    places = np.empty((*shape[:-1], 8))
    places[..., 0], places[..., 7] = 0.0, 1.0
    places[..., 1:4], places[..., 4:7] = (lower - first) / passing, (upper - first) / passing
    places = np.sort(np.clip(places, 0.0, 1.0), axis=-1)
    low, high = np.zeros(shape[:-1], int), np.full(shape[:-1], 7)
    for _ in range(3):
        middle = (low + high) // 2
        falls = slope(np.take_along_axis(places, middle[..., None], axis=-1)[..., 0]) <= 0
        low, high = np.where(falls, middle, low), np.where(falls, high, middle)
    begin = np.take_along_axis(places, low[..., None], axis=-1)[..., 0]
    end = np.take_along_axis(places, high[..., None], axis=-1)[..., 0]
    at_begin, at_end = slope(begin), slope(end)
    rise = at_end - at_begin
    share = begin - at_begin * (end - begin) / np.where(rise > 0, rise, 1.0)
    away = excess(np.minimum(np.maximum(share, begin), end))
    best: Array = np.sqrt(np.einsum("...i,...i->...", away, away))
    return best


def segment_to_segment(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Distance (...) between segments [m]; all arguments broadcast to (..., 3)."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    det = uu * vv - uv**2
    safe = np.where(det > 1e-12, det, 1.0)
    s = np.where(det > 1e-12, np.clip((uv * vw - vv * uw) / safe, 0, 1), 0.0)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-12), 0, 1)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-12), 0, 1)
    best: Array = np.sqrt(((w + s[..., None] * u - t[..., None] * v) ** 2).sum(-1))
    return best


def block_gap(centre: Array, half: Array, lower: Array, upper: Array) -> Array:
    """Signed gap (...) between axis-parallel blocks along their best axis [m]."""
    gap: Array = np.maximum(lower - (centre + half), (centre - half) - upper).max(axis=-1)
    return gap


def upright_gap(
    centre: Array, yaw: Array, half: Array, other: Array, its_yaw: Array, its_half: Array
) -> Array:
    """Signed gap (...) between upright blocks along their best axis [m].

    Blocks have centres (..., 3), yaws (...) about the vertical and half edges (3,). Of convex
    outlines the best axis is a normal of one of their edges, so that the sign is exact.
    """
    apart = other - centre
    gaps = [np.abs(apart[..., 2]) - half[2] - its_half[2]]
    for turned in (yaw, its_yaw):
        for axis in (turned, turned + np.pi / 2):
            away = np.abs(apart[..., 0] * np.cos(axis) + apart[..., 1] * np.sin(axis))
            spans = [
                h[0] * np.abs(np.cos(y - axis)) + h[1] * np.abs(np.sin(y - axis))
                for h, y in ((half, yaw), (its_half, its_yaw))
            ]
            gaps.append(away - spans[0] - spans[1])
    gap: Array = np.max(gaps, axis=0)
    return gap
