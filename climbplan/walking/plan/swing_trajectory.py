"""Swing trajectories of plans, as functions of the fraction of their time, from rest to rest.

The horizontal path is straight with a quintic profile; the height has a quartic arch. Joint
speeds, whole-body simulation and exports use them. Where a foot would hit a riser it first moves
up alone, or at last down alone, as long as is necessary.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.height_grid import find_highest_near

_VERTICAL_FRACTIONS = (0.0, 0.1, 0.2, 0.3)  # fractions of a swing, vertical alone
_NUM_SAMPLES = 33  # of a swing, for clearance
_CLEARANCE_TOLERANCE = 0.003  # [m] by which feet may be nearer to risers than their radius
_LEVEL, _UP = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])

Fraction = TypeVar("Fraction", float, Array)


def quintic_progress(s: Fraction) -> tuple[Fraction, Fraction, Fraction]:
    """Return the quintic from 0 to 1, at rest at both ends, and its two derivatives."""
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2,
        60 * s * (1 - s) * (1 - 2 * s),
    )


def quartic_arch(s: Fraction) -> tuple[Fraction, Fraction, Fraction]:
    """Return the quartic from 0 up to 1 and back to 0, and its two derivatives."""
    return (
        16 * s**2 * (1 - s) ** 2,
        32 * s * (1 - s) * (1 - 2 * s),
        32 * (1 - 6 * s + 6 * s**2),
    )


@dataclass(frozen=True)
class SwingTrajectory:
    """A swing trajectory from lift-off to touchdown."""

    lift_off: Array  # (3,) [m]
    touchdown: Array  # (3,) [m]
    apex_height: float  # of the middle above the straight line [m]
    rise_fraction: float = 0.0  # of the swing, upwards alone
    descent_fraction: float = 0.0  # of the swing, downwards alone

    def evaluate(self, fraction: float) -> tuple[Array, Array, Array]:
        """Return the position (3,) at a fraction of the time, and its two derivatives."""
        rate = 1.0 / (1.0 - self.rise_fraction - self.descent_fraction)
        progress, speed, progress_curvature = quintic_progress(
            float(np.clip(rate * (fraction - self.rise_fraction), 0.0, 1.0))
        )
        upward, climbing, rise_curvature = quintic_progress(fraction)
        up, rising, arch_curvature = quartic_arch(fraction)
        level, rise = (
            _LEVEL * (self.touchdown - self.lift_off),
            float(self.touchdown[2] - self.lift_off[2]),
        )
        return (
            self.lift_off + progress * level + (upward * rise + up * self.apex_height) * _UP,
            rate * speed * level + (climbing * rise + rising * self.apex_height) * _UP,
            rate**2 * progress_curvature * level
            + (rise_curvature * rise + arch_curvature * self.apex_height) * _UP,
        )


def choose_vertical_fractions(
    ground: Ground, lift_off: Array, touchdown: Array, apex_height: float, foot_radius: float
) -> tuple[float, float]:
    """Choose the fractions of a swing, first and last, in which its toe moves vertically alone.

    They are the smallest with which the toe is above all terrain that its foot passes; the largest
    if none suffices.

    Args:
        ground: the planes that toes stand on.
        lift_off: (3,) [m].
        touchdown: (3,) [m].
        apex_height: height of the middle above the straight line [m].
        foot_radius: radius of the foot, 0 for a point [m].
    """
    if ground.count == 1 and ground.scan is None:
        return 0.0, 0.0
    fraction = np.linspace(0.0, 1.0, _NUM_SAMPLES)
    height = (
        lift_off[2]
        + quintic_progress(fraction)[0] * (touchdown[2] - lift_off[2])
        + quartic_arch(fraction)[0] * apex_height
    )
    every = np.arange(ground.count)
    chosen = [_VERTICAL_FRACTIONS[-1], _VERTICAL_FRACTIONS[-1]]
    for end, half in enumerate((fraction <= 0.5, fraction >= 0.5)):
        for candidate in _VERTICAL_FRACTIONS:
            first, last = (candidate, 0.0) if end == 0 else (0.0, candidate)
            progress = quintic_progress(
                np.clip((fraction[half] - first) / (1.0 - first - last), 0.0, 1.0)
            )[0]
            spots = lift_off[:2] + progress[:, None] * (touchdown - lift_off)[:2]
            off = ground.compute_distance_outside(every, spots[:, None])  # (K, S)
            level = ground.compute_height(every, spots[:, None])
            beneath = np.where(off < foot_radius - _CLEARANCE_TOLERANCE, level, -np.inf).max(axis=1)
            if ground.scan is not None:
                raw = find_highest_near(ground.height_grid, spots, foot_radius)
                beneath = np.maximum(beneath, raw)
            if (height[half] >= beneath - _CLEARANCE_TOLERANCE).all():
                chosen[end] = candidate
                break
    return chosen[0], chosen[1]
