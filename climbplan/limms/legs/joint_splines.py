"""Motions of joints as quadratic splines: speeds follow exactly from the control points.

The control points of a quadratic spline's rate are differences of its own, so that speed limits at
those hold at every instant.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from climbplan.arrays import Array


def _knots(controls: int) -> Array:
    inner = np.linspace(0.0, 1.0, controls - 1)
    return np.concatenate([[0.0, 0.0], inner, [1.0, 1.0]])


def spline_weights(controls: int, shares: Array) -> Array:
    """Weights (n, controls) of control points at shares (n,) of the time."""
    knots = _knots(controls)
    weights: Array = BSpline.design_matrix(np.clip(shares, 0.0, 1.0), knots, 2).toarray()
    return weights


def rate_weights(controls: int) -> Array:
    """Control points (controls - 1, controls) of the rate, in units per whole time."""
    knots = _knots(controls)
    weights = np.zeros((controls - 1, controls))
    for j in range(controls - 1):
        weights[j, j : j + 2] = np.array([-2.0, 2.0]) / (knots[j + 3] - knots[j + 1])
    return weights


def spline_rates(controls: Array, shares: Array) -> Array:
    """Rates (n, ...) of a spline with control points (C, ...) at shares (n,), per whole time."""
    knots = _knots(len(controls))
    rates: Array = BSpline(knots, controls, 2).derivative()(np.clip(shares, 0.0, 1.0))
    return rates
