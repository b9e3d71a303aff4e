"""Algorithm 3: both blocks in turn, weights growing, residuals of eq. (6.13) recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.limms.consensus.mixed_integer import Copy, Found, MixedInteger, Modes
from climbplan.limms.consensus.nonlinear import Bent, Nonlinear
from climbplan.limms.consensus.setting import POINTS, Setting, chain_points
from climbplan.limms.scene import Array

GOOD = (0.01, 0.01, 0.1)  # [m], [m], [rad] mean residuals to reach
NEAR_GOAL = 1e-3  # [m] an incumbent worth keeping the integers of
LATCHED = 1e-4  # [m] by which latches of an iterate may be off
_FRAMES = np.array([0, 0, 1, 2, 2, 3, 3, 3])  # straight link along the z axis of each frame


@dataclass(frozen=True)
class Residual:
    """Disagreement of the blocks, eq. (6.13): means and largest values."""

    box: tuple[float, float]  # r_pB [m]
    points: tuple[float, float]  # r_pL [m]
    axes: tuple[float, float]  # r_RL [rad]

    @property
    def good(self) -> bool:
        """Whether the means are where they should be."""
        means = (self.box[0], self.points[0], self.axes[0])
        return all(value <= limit for value, limit in zip(means, GOOD, strict=True))


@dataclass(frozen=True)
class Step:
    """Record of one iteration."""

    residual: Residual
    violation: float  # of the nonlinear block [m]
    penetration: float  # of its links [m]
    missed: float  # of the goal by the mixed-integer block [m]
    mixed_integer_seconds: float
    nonlinear_seconds: float
    frozen: bool


@dataclass(frozen=True)
class Iterate:
    """What the blocks agreed on best."""

    number: int
    modes: Modes
    copy: Copy  # of the nonlinear block
    angles: Array
    velocity: Array  # of the box, from the mixed-integer block
    residual: Residual
    violation: float

    def rank(self) -> tuple[bool, float]:
        """Smaller is better: latches that hold first, then agreement."""
        r = self.residual
        return (self.violation > LATCHED, r.box[0] + r.points[0] + 0.1 * r.axes[0])


def residual_of(setting: Setting, one: Copy, other: Copy) -> Residual:
    """Eq. (6.13) of two copies; the start, which both have, is left out.

    Frames differ in their z axes, which points fix: the mixed-integer block leaves the others
    free, so that they are as the nonlinear block has them.
    """
    module = setting.scene.module
    box = np.linalg.norm(one.box[1:] - other.box[1:], axis=-1)
    gone = chain_points(one.points[1:], module) - chain_points(other.points[1:], module)
    points = np.linalg.norm(gone, axis=-1)
    axes = np.linalg.norm(_axes(setting, one) - _axes(setting, other), axis=-1)[..., _FRAMES]
    return Residual(
        *((float(values.mean()), float(values.max())) for values in (box, points, axes))
    )


def _axes(setting: Setting, copy: Copy) -> Array:
    """Directions (K, L, 4, 3) of links."""
    found: Array = np.diff(copy.points[1:], axis=2) / setting.links[:, None]
    return found


