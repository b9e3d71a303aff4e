"""The admittance controller of position-controlled legs, eqs. (8.27) to (8.29), on compliant legs.

A leg tracks the planned position and the planned force at once: its commanded toe is off the
planned place x0 by x - x0, which obeys, axis by axis in the world frame,

    M (x - x0)'' + D (x - x0)' + K (x - x0) = Kf (f_measured - F_planned).

x0 moves with the body as planned since the knot, and is below the ground by the leg's deflection
under the planned force; where body and plan agree the leg gives exactly that force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray


@dataclass(frozen=True)
class AdmittanceGains:
    """Published for climbing without units; those of walking and the leg's own are assumed."""

    mass: float = 1.0  # [kg] M
    damping: float = 80.0  # [N s/m] D
    stiffness: float = 400.0  # [N/m] K
    force: float = 0.3  # Kf
    leg_stiffness: float = 3000.0  # [N/m] from commanded to actual toe
    leg_damping: float = 30.0  # [N s/m]
    period: float = 1e-3  # [s] of the controller


class AdmittanceLegs:
    """Forces of compliant legs within a knot, and the controller that moves their commands."""

    def __init__(self, gains: AdmittanceGains, legs: int) -> None:
        self.gains = gains
        self._off, self._rate = np.zeros((legs, 3)), np.zeros((legs, 3))

    def begin(self) -> None:
        """A new knot: commands start where the plan has them."""
        self._off, self._rate = np.zeros_like(self._off), np.zeros_like(self._rate)

    def force(self, planned: Array, ahead: Array, rate: Array) -> Array:
        """Contact forces (L, 3) on the robot, before the ground's limits.

        planned (L, 3) forces; ahead (L, 3): how far the true toe is from where the plan would have
        it as seen from the true body [m]; rate: its change [m/s]. World frame.
        """
        gains = self.gains
        stretched = gains.leg_stiffness * (ahead - self._off)
        force: Array = planned + stretched + gains.leg_damping * (rate - self._rate)
        return force

    def step(self, planned: Array, measured: Array, dt: float) -> None:
        """Eq. (8.28) over dt with both forces constant."""
        gains = self.gains
        parts = max(1, round(dt / gains.period))
        h = dt / parts
        pull = gains.force * (measured - planned)
        for _ in range(parts):
            back = -gains.damping * self._rate - gains.stiffness * self._off
            self._rate = self._rate + h / gains.mass * (back + pull)
            self._off = self._off + h * self._rate


def limited(force: Array, contact: BoolArray, friction: float, most: float) -> Array:
    """What the ground can give (L, 3): no pull, within friction cones and components' limits."""
    result = np.clip(force, -most, most)
    result[:, 2] = np.maximum(result[:, 2], 0.0)
    room = friction * result[:, 2]
    sideways = np.hypot(result[:, 0], result[:, 1])
    result[:, :2] *= np.minimum(1.0, room / np.maximum(sideways, 1e-12))[:, None]
    result[~contact] = 0.0
    return result
