"""Exact distances of links (segments with a radius) from blocks and from each other, vectorised."""

from __future__ import annotations

import numpy as np

from climbplan.limms.scene import Array

_GOLDEN = (np.sqrt(5.0) - 1) / 2
_ROUNDS = 24  # the distance is convex along the segment: its place to 1e-5 of its length


def segment_to_block(first: Array, last: Array, lower: Array, upper: Array) -> Array:
    """Distance (...) of segments from axis-parallel blocks [m]; 0 if they touch or are inside.

    All arguments broadcast to (..., 3).
    """
    shape = np.broadcast_shapes(first.shape, last.shape, lower.shape, upper.shape)
    first, last = np.broadcast_to(first, shape), np.broadcast_to(last, shape)
    span = last - first

    def distance(share: Array) -> Array:
        point = first + share[..., None] * span
        out = np.maximum(np.maximum(lower - point, point - upper), 0.0)
        found: Array = np.sqrt((out**2).sum(axis=-1))
        return found

    low, high = np.zeros(shape[:-1]), np.ones(shape[:-1])
    c, d = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_c, at_d = distance(c), distance(d)
    for _ in range(_ROUNDS):
        left = at_c <= at_d
        high, low = np.where(left, d, high), np.where(left, low, c)
        c_new = high - _GOLDEN * (high - low)
        d_new = low + _GOLDEN * (high - low)
        fresh = distance(np.where(left, c_new, d_new))
        at_c, at_d = np.where(left, fresh, at_d), np.where(left, at_c, fresh)
        c, d = c_new, d_new
    ends = np.minimum(distance(np.zeros(shape[:-1])), distance(np.ones(shape[:-1])))
    best: Array = np.minimum(np.minimum(at_c, at_d), ends)
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
