"""Paths of a box: chains of cubics, whose acceleration is linear between knots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.motion.timeline import sample_times


class BoxPath(NamedTuple):
    """Positions [m], velocities [m/s] and accelerations [m/s^2], each (n, 3)."""

    position: Array
    velocity: Array
    acceleration: Array


def evaluate_box_path(
    duration: float, position: Array, velocity: Array, acceleration: Array, time: Array
) -> BoxPath:
    """Return the path of a box at times (n,) of a phase, from its knots (K + 1, 3)."""
    count = len(position) - 1
    step = duration / count
    k = np.clip((time / step + 1e-9).astype(int), 0, count - 1)
    t = (time - k * step)[:, None]
    a0, a1 = acceleration[k], acceleration[k + 1]
    slope = (a1 - a0) / step
    return BoxPath(
        position[k] + velocity[k] * t + a0 * t**2 / 2 + slope * t**3 / 6,
        velocity[k] + a0 * t + slope * t**2 / 2,
        a0 + slope * t,
    )


def sample_knots(duration: float, intervals: int, finer: int = 1) -> Array:
    """Return times (n,) of a phase that include all knots, so no cubic ends between two samples.

    Args:
        duration: Duration of the phase [s].
        intervals: Number of intervals.
        finer: Factor of the density of a plan's samples.
    """
    step = duration / intervals
    inner = sample_times(finer * step) / finer
    pieces = [k * step + inner[:-1] for k in range(intervals)]
    return np.concatenate([*pieces, [duration]])
