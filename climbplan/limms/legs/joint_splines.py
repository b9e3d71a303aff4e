"""Joint motions as quadratic B-splines: their rates follow exactly from control points.

Control points of the rate are differences of control points, so by the convex hull property speed
limits at those hold at every instant.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from climbplan.arrays import Array


def _build_knot_vector(controls: int) -> Array:
    """Return the clamped, uniform knot vector."""
    inner = np.linspace(0.0, 1.0, controls - 1)
    return np.concatenate([[0.0, 0.0], inner, [1.0, 1.0]])


def compute_spline_weights(controls: int, shares: Array) -> Array:
    """Return weights (n, controls) of control points at fractions (n,) of the time."""
    knots = _build_knot_vector(controls)
    weights: Array = BSpline.design_matrix(np.clip(shares, 0.0, 1.0), knots, 2).toarray()
    return weights


def compute_rate_weights(controls: int) -> Array:
    """Return control points of the rate, (controls - 1, controls), per total time."""
    knots = _build_knot_vector(controls)
    weights = np.zeros((controls - 1, controls))
    for j in range(controls - 1):
        weights[j, j : j + 2] = np.array([-2.0, 2.0]) / (knots[j + 3] - knots[j + 1])
    return weights


def compute_spline_rates(controls: Array, shares: Array) -> Array:
    """Return rates (n, ...) of a spline with control points (C, ...) at fractions (n,), per total
    time.
    """
    knots = _build_knot_vector(len(controls))
    rates: Array = BSpline(knots, controls, 2).derivative()(np.clip(shares, 0.0, 1.0))
    return rates
