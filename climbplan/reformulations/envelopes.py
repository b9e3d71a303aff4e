"""Envelopes of one product w = x y on boxes: corners for weights, half-spaces for plain rows.

Eq. (8.26) on [x^L, x^U] x [y^L, y^U] is the hull of the four corners (x, y, x y). A point in the
envelope is therefore a convex combination of them, eq. (8.12) (McCormick 1976).

Equation numbers are those of X. Lin (UCLA 2022).
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
    """Half-spaces a x + b y + c w <= d, four for each of K products."""

    a: Array  # (K, 4)
    b: Array
    c: Array
    d: Array


def compute_product_corners(x_low: Array, x_high: Array, y_low: Array, y_high: Array) -> Corners:
    """Return the four corners of each cell (N,)."""
    x = np.stack([x_low, x_low, x_high, x_high], axis=1)
    y = np.stack([y_low, y_high, y_low, y_high], axis=1)
    return Corners(x, y, x * y)


def compute_product_weights(corners: Corners, x: Array, y: Array) -> Array:
    """Return weights (N, 4) that reproduce (x, y, x y) exactly in each cell."""
    s = _compute_fraction(x, corners.x[:, 0], corners.x[:, 3])
    t = _compute_fraction(y, corners.y[:, 0], corners.y[:, 3])
    return np.stack([(1 - s) * (1 - t), (1 - s) * t, s * (1 - t), s * t], axis=1)


def compute_square_corners(low: Array, high: Array, squares: Squares) -> Corners:
    """Return the ends of the chord, and for the envelope the intersection of both end tangents."""
    ends = [(low, low**2), (high, high**2)]
    if squares == "envelope":
        ends.append((0.5 * (low + high), low * high))
    x = np.stack([e[0] for e in ends], axis=1)
    return Corners(x, x, np.stack([e[1] for e in ends], axis=1))


def compute_square_weights(corners: Corners, x: Array) -> Array:
    """Return weights (N, 3 or 2) that reproduce x, and x^2 if there is a tangent corner."""
    s = _compute_fraction(x, corners.x[:, 0], corners.x[:, 1])
    if corners.x.shape[1] == 2:
        return np.stack([1 - s, s], axis=1)
    # Bernstein polynomials: the tangents' corner is the middle control point of the parabola
    return np.stack([(1 - s) ** 2, s**2, 2 * s * (1 - s)], axis=1)


def build_halfspaces(
    x_low: Array, x_high: Array, y_low: Array, y_high: Array, square: Array, squares: Squares
) -> Halfspaces:
    """Build eq. (8.26); for squares the tangents at both ends and the chord, or the chord alone."""
    unit = np.ones_like(x_low)
    a = np.stack([y_low, y_high, -y_low, -y_high], axis=1)
    b = np.stack([x_low, x_high, -x_high, -x_low], axis=1)
    c = np.stack([-unit, -unit, unit, unit], axis=1)
    d = np.stack([x_low * y_low, x_high * y_high, -x_high * y_low, -x_low * y_high], axis=1)
    if squares == "secant":
        # The chord from below replaces both tangents
        for k in (0, 1):
            a[:, k] = np.where(square, 0.5 * (x_low + x_high), a[:, k])
            b[:, k] = np.where(square, 0.5 * (x_low + x_high), b[:, k])
            d[:, k] = np.where(square, x_low * x_high, d[:, k])
    return Halfspaces(a, b, c, d)


def _compute_fraction(value: Array, low: Array, high: Array) -> Array:
    """Return the relative position of a value in a range."""
    width = np.where(high > low, high - low, 1.0)
    return np.clip((value - low) / width, 0.0, 1.0)
