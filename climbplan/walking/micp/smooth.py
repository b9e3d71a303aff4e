"""Sine, secant and tangent as straight lines within a range, and how far they are off at most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Function = Literal["secant", "tangent"]

_GRID = 201  # points of a range
_PAD = 1e-12  # of rounding


@dataclass(frozen=True)
class Straight:
    """A function of x is middle + slope (x - x_middle) within `off`."""

    middle: float
    slope: float
    off: float


def sine(half: float) -> tuple[float, float]:
    """A slope of sin x for |x| <= half <= pi / 2, and how far the line is off at most."""
    if half < 1e-9:
        return 1.0, half
    slope = max(1.0 - half**2 / 8.0, 0.0)  # off alike between and at the ends, to fourth order
    # sin x - slope x rises up to where the cosine is the slope, and falls from there.
    top = min(float(np.arccos(slope)), half)
    return slope, max(abs(float(np.sin(x)) - slope * x) for x in (top, half)) + _PAD


def straight(name: Function, middle: float, half: float) -> Straight:
    """The line through both ends, moved halfway to what lies between; |middle| + half < pi / 2."""
    x = np.linspace(middle - half, middle + half, _GRID)
    values = 1.0 / np.cos(x) if name == "secant" else np.tan(x)
    if half < 1e-9:
        return Straight(float(values[0]), 0.0, float(np.ptp(values)) + _PAD)
    steepest = abs(middle) + half
    sec, tan = 1.0 / np.cos(steepest), np.tan(steepest)
    bent = sec * (tan**2 + sec**2) if name == "secant" else 2.0 * sec**2 * tan
    slope = (values[-1] - values[0]) / (2.0 * half)
    left = values - slope * (x - middle)
    off = 0.5 * np.ptp(left) + (x[1] - x[0]) ** 2 * bent / 8.0  # between points of the grid
    return Straight(float(0.5 * (left.min() + left.max())), float(slope), float(off) + _PAD)
