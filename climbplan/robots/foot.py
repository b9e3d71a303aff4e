"""Feet of finite size: where a limb touches its surface, seen from its toe.

The toe of a limb is the point that its kinematics place. A spherical foot has the toe in its centre
and touches a surface of unit normal n, into free space, at toe - radius n: there the contact force
acts, and pushes whatever the joints do as a force at that point of the last link. A contact rolls:
when the last link turns, the point of it that touches stands still, which is what that point's
Jacobian says, to first order. Point toes are spheres of radius zero.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.robots.rotations import Array


@dataclass(frozen=True)
class Foot:
    """Spherical feet, the same on every limb."""

    radius: float  # [m]

    def arm(self, normal: Array) -> Array:
        """From the toe to where it touches (..., 3) [m], for unit normals (..., 3)."""
        return -self.radius * normal
