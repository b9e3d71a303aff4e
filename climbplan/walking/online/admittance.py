"""Admittance control of position-controlled, compliant legs, eqs. (8.27) to (8.29).

A leg tracks the planned position and the planned force together. Its commanded toe deviates from
the planned position x0 by x - x0, which obeys in each axis of the world frame

    M (x - x0)'' + D (x - x0)' + K (x - x0) = Kf (f_measured - F_planned).

x0 moves with the body as planned since the knot, and is below the ground by the leg's deflection
under the planned force. Where body and plan agree the leg therefore exerts exactly that force.

Published methods, and equation numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray


@dataclass(frozen=True)
class AdmittanceGains:
    """Gains of the controller and compliance of the legs.

    They are published for climbing only, and without units. The values for walking are
    assumptions.
    """

    mass: float = 1.0  # [kg] M
    damping: float = 80.0  # [N s/m] D
    stiffness: float = 400.0  # [N/m] K
    force: float = 0.3  # Kf
    leg_stiffness: float = 3000.0  # [N/m] from commanded to actual toe
    leg_damping: float = 30.0  # [N s/m]
    period: float = 1e-3  # [s] of the controller


class AdmittanceController:
    """The admittance controller of all legs, with the forces of the compliant legs."""

    def __init__(self, gains: AdmittanceGains, legs: int) -> None:
        self.gains = gains
        self._offset, self._offset_rate = np.zeros((legs, 3)), np.zeros((legs, 3))

    def reset(self) -> None:
        """Start a knot: commanded toes are the planned ones."""
        self._offset, self._offset_rate = (
            np.zeros_like(self._offset),
            np.zeros_like(self._offset_rate),
        )

    def compute_forces(self, planned: Array, toe_offset: Array, toe_offset_rate: Array) -> Array:
        """Return contact forces (L, 3) before friction and force limits, world frame [N].

        Args:
            planned: (L, 3) planned forces [N].
            toe_offset: (L, 3) true toe minus planned toe, both relative to the true body [m].
            toe_offset_rate: (L, 3) its rate [m/s].
        """
        gains = self.gains
        spring_force = gains.leg_stiffness * (toe_offset - self._offset)
        force: Array = (
            planned + spring_force + gains.leg_damping * (toe_offset_rate - self._offset_rate)
        )
        return force

    def integrate(self, planned: Array, measured: Array, dt: float) -> None:
        """Integrate eq. (8.28) over dt with constant forces (L, 3)."""
        gains = self.gains
        num_substeps = max(1, round(dt / gains.period))
        substep = dt / num_substeps
        force_error = gains.force * (measured - planned)
        for _ in range(num_substeps):
            restoring_force = -gains.damping * self._offset_rate - gains.stiffness * self._offset
            self._offset_rate = self._offset_rate + substep / gains.mass * (
                restoring_force + force_error
            )
            self._offset = self._offset + substep * self._offset_rate


def limit_forces(force: Array, contact: BoolArray, friction: float, force_limit: float) -> Array:
    """Return forces (L, 3) that the ground can exert.

    Normal forces do not pull, and all are within friction cones and limits of each component.
    """
    limited = np.clip(force, -force_limit, force_limit)
    limited[:, 2] = np.maximum(limited[:, 2], 0.0)
    friction_limit = friction * limited[:, 2]
    tangential = np.hypot(limited[:, 0], limited[:, 1])
    limited[:, :2] *= np.minimum(1.0, friction_limit / np.maximum(tangential, 1e-12))[:, None]
    limited[~contact] = 0.0
    return limited
