"""Envelopes of one product w = x y on boxes: corners for weights, half-spaces for plain rows.

Eq. (8.26) on [x^L, x^U] x [y^L, y^U] is the hull of the four corners (x, y, x y), so a point in the
envelope is a convex combination of them, eq. (8.12).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array

Squares = Literal["envelope", "secant"]


@dataclass(frozen=True)
class Corners:
    """Vertices (x, y, w) of the envelope on each of N cells."""

    x: Array  # (N, V)
    y: Array  # (N, V)
    w: Array  # (N, V)


@dataclass(frozen=True)
class Halfspaces:
    """a x + b y + c w <= d, four of them for each of K products."""

    a: Array  # (K, 4)
    b: Array
    c: Array
    d: Array


def product_corners(x_low: Array, x_high: Array, y_low: Array, y_high: Array) -> Corners:
    """The four corners of each cell (N,)."""
    x = np.stack([x_low, x_low, x_high, x_high], axis=1)
    y = np.stack([y_low, y_high, y_low, y_high], axis=1)
    return Corners(x, y, x * y)


def product_weights(corners: Corners, x: Array, y: Array) -> Array:
    """Weights (N, 4) that reproduce (x, y, x y) exactly in each cell."""
    s = _share(x, corners.x[:, 0], corners.x[:, 3])
    t = _share(y, corners.y[:, 0], corners.y[:, 3])
    return np.stack([(1 - s) * (1 - t), (1 - s) * t, s * (1 - t), s * t], axis=1)


def square_corners(low: Array, high: Array, squares: Squares) -> Corners:
    """Chord ends, and for the envelope the point where the tangents at both ends meet."""
    ends = [(low, low**2), (high, high**2)]
    if squares == "envelope":
        ends.append((0.5 * (low + high), low * high))
    x = np.stack([e[0] for e in ends], axis=1)
    return Corners(x, x, np.stack([e[1] for e in ends], axis=1))


def square_weights(corners: Corners, x: Array) -> Array:
    """Weights (N, 3 or 2) that reproduce x, and x^2 if there is a tangent corner."""
    s = _share(x, corners.x[:, 0], corners.x[:, 1])
    if corners.x.shape[1] == 2:
        return np.stack([1 - s, s], axis=1)
    # Bernstein polynomials: the tangents' corner is the middle control point of the parabola.
    return np.stack([(1 - s) ** 2, s**2, 2 * s * (1 - s)], axis=1)


def halfspaces(
    x_low: Array, x_high: Array, y_low: Array, y_high: Array, square: Array, squares: Squares
) -> Halfspaces:
    """Eq. (8.26); of squares the tangents at both ends and the chord, or the chord alone."""
    one = np.ones_like(x_low)
    a = np.stack([y_low, y_high, -y_low, -y_high], axis=1)
    b = np.stack([x_low, x_high, -x_high, -x_low], axis=1)
    c = np.stack([-one, -one, one, one], axis=1)
    d = np.stack([x_low * y_low, x_high * y_high, -x_high * y_low, -x_low * y_high], axis=1)
    if squares == "secant":
        # The chord from below takes the place of the first tangent, and is repeated.
        for k in (0, 1):
            a[:, k] = np.where(square, 0.5 * (x_low + x_high), a[:, k])
            b[:, k] = np.where(square, 0.5 * (x_low + x_high), b[:, k])
            d[:, k] = np.where(square, x_low * x_high, d[:, k])
    return Halfspaces(a, b, c, d)


def _share(value: Array, low: Array, high: Array) -> Array:
    width = np.where(high > low, high - low, 1.0)
    return np.clip((value - low) / width, 0.0, 1.0)
