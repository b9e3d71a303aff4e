"""How far chains are bent off full stretch, as an expression of a program.

Programs meet their rows up to a tolerance, and bodies that turn between two poses leave the
straight way: toes that a stretched limb alone reaches are out of reach a moment later.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

# Of two equal links behind two hips, a knee bent by the angle whose cosine is 1 - room has the
# square of `bent_by` at this times room, to first order
_BY_KNEE = 2 / 45
_TINY = 1e-12  # keeps roots smooth


def least_bent(room: float) -> float:
    """What `bent_by` is to be at least, `room` off full stretch of a knee's cosine."""
    return float(np.sqrt(_BY_KNEE * room))


def bent_by(columns: list[Any], side: Any) -> Any:
    """(1, N) how far toes are from where they could not move on in some direction.

    columns: (3, N) by angle, of J. The root of 1 / (tr M tr M^-1), M = J J^T: the least singular
    value of J over the root of the sum of all squares, or up to a root of three below that. Zero at
    full stretch, and wherever else a toe is on the border of what a limb inside its joint bounds
    reaches. side: (1, N) of det J, below zero on the other: inverse kinematics of three joints
    bend one way; None: of more joints, which bend any way.
    """
    xx, yy, zz, xy, yz, xz = (
        sum(c[a, :] * c[b, :] for c in columns)
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    )
    across = (yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2)  # diagonal of M's adjugate
    size = sum(across) * (xx + yy + zz)
    if side is not None:
        one, two, three = columns
        return side * ca.sum1(one * ca.cross(two, three)) / ca.sqrt(size)
    volume = xx * across[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)  # det M
    return ca.sqrt(volume / size + _TINY)
