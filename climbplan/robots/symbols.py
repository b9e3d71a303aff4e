"""Rotations as CasADi expressions."""

from __future__ import annotations

from typing import Any

import casadi as ca


def build_rotation(rpy: Any) -> Any:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), body to world, as an expression.

    rpy: (3,) [rad].
    """
    cr, cp, cy = (ca.cos(rpy[k]) for k in range(3))
    sr, sp, sy = (ca.sin(rpy[k]) for k in range(3))
    return ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        ca.horzcat(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
