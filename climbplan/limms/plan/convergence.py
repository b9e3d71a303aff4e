"""Residuals of a consensus by iteration, as stored in a plan.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array, IntArray

RESIDUALS = {"box": "m", "points": "m", "axes": "rad"}  # r_pB, r_pL and r_RL, eq. (6.13)


@dataclass(frozen=True)
class Convergence:
    """Residuals of I iterations; those of one choice of modes have the same `attempt`."""

    attempt: IntArray  # (I,) from 0
    frozen: IntArray  # (I,) 1 where the integers were fixed
    box_mean: Array  # (I,) r_pB [m]
    box_max: Array
    points_mean: Array  # (I,) r_pL [m]
    points_max: Array
    axes_mean: Array  # (I,) r_RL [rad]
    axes_max: Array
    missed: Array  # (I,) [m] distance to the goal in the mixed-integer block
    violation: Array  # (I,) [m] of latches and gaps in the nonlinear block
    mixed_integer_seconds: Array  # (I,)
    nonlinear_seconds: Array  # (I,)
