"""Paths of a box: chains of cubics, whose acceleration is linear between knots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.motion.timeline import samples


class BoxPath(NamedTuple):
    """Position [m], velocity [m/s] and acceleration [m/s^2], each (n, 3)."""

    position: Array
    velocity: Array
    acceleration: Array


def box_path(
    duration: float, position: Array, velocity: Array, acceleration: Array, time: Array
) -> BoxPath:
    """A box at times (n,) of a phase, from its knots (K + 1, 3)."""
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


def knot_samples(duration: float, intervals: int, finer: int = 1) -> Array:
    """Times (n,) of a phase, all of its knots among them: no cubic ends between two samples.

    finer: how many times as dense as samples of plans are at least.
    """
    step = duration / intervals
    inner = samples(finer * step) / finer
    whole = [k * step + inner[:-1] for k in range(intervals)]
    return np.concatenate([*whole, [duration]])
