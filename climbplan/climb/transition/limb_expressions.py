"""Limbs' closed-form inverse kinematics and torques as expressions, knee branches given.

The same formulas as in `robots.kinematics`, with rounding at full stretch cut off so that they stay
finite a little out of reach, where a row of the program says that the toe is too far. Matrices have
one column a limb.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

_CUT = 1e-9  # of the cosine of the knee angle


@dataclass(frozen=True)
class LimbExpressions:
    """N limbs with their toes at points."""

    angles: Any  # (3, N) coxa, femur, tibia [rad], coxa not wrapped
    stretch: Any  # (1, N) cosine of the knee's angle: within -1 and 1 if the toe is in reach
    radial: Any  # (2, N) unit horizontal direction to the toe, body frame
    reach: Any  # (2, N) horizontal distance beyond the coxa and height of the toe [m]


def limb_expressions(
    shoulder: Any, links: Any, mount_yaw: Any, middle: Any, toe: Any, branch: Any
) -> LimbExpressions:
    """Joint angles for toes (3, N) in the body frame; branch: -1 knee up, 1 knee down.

    middle: (1, N) of the coxa's bounds [rad], to which its angle is wrapped.
    """
    offset = toe - shoulder
    distance = ca.sqrt(offset[0, :] ** 2 + offset[1, :] ** 2 + 1e-12)
    u, z = distance - links[0, :], offset[2, :]
    stretch = (u**2 + z**2 - links[1, :] ** 2 - links[2, :] ** 2) / (2 * links[1, :] * links[2, :])
    inside = ca.fmax(ca.fmin(stretch, 1 - _CUT), -1 + _CUT)
    beta = branch * ca.acos(inside)
    knee = ca.atan2(links[2, :] * ca.sin(beta), links[1, :] + links[2, :] * ca.cos(beta))
    # The angle from the middle of the coxa's bounds, where atan2 has no jump.
    heading = mount_yaw + middle
    along = offset[0, :] * ca.cos(heading) + offset[1, :] * ca.sin(heading)
    across = -offset[0, :] * ca.sin(heading) + offset[1, :] * ca.cos(heading)
    coxa = middle + ca.atan2(across, along)
    angles = ca.vertcat(coxa, ca.atan2(z, u) - knee, beta + ca.pi / 2)
    radial = ca.vertcat(offset[0, :] / distance, offset[1, :] / distance)
    return LimbExpressions(angles, stretch, radial, ca.vertcat(u, z))


def free_toes(limbs: LimbExpressions, shoulder: Any, links: Any, bent: Any) -> Any:
    """Where toes (3, N) would be in free space, body frame, with joints `bent` (3, N) back."""
    femur, tibia = limbs.angles[1, :] - bent[1, :], limbs.angles[2, :] - bent[2, :]
    u = links[1, :] * ca.cos(femur) + links[2, :] * ca.sin(femur + tibia)
    z = links[1, :] * ca.sin(femur) - links[2, :] * ca.cos(femur + tibia)
    out, turn = links[0, :] + u, -bent[0, :]
    x = limbs.radial[0, :] * ca.cos(turn) - limbs.radial[1, :] * ca.sin(turn)
    y = limbs.radial[0, :] * ca.sin(turn) + limbs.radial[1, :] * ca.cos(turn)
    return shoulder + ca.vertcat(out * x, out * y, z)


def torques(limbs: LimbExpressions, links: Any, force: Any) -> Any:
    """Joint torques J^T f (3, N) of forces (3, N) on the toes, body frame."""
    outward = limbs.radial[0, :] * force[0, :] + limbs.radial[1, :] * force[1, :]
    sideways = limbs.radial[0, :] * force[1, :] - limbs.radial[1, :] * force[0, :]
    u, z = limbs.reach[0, :], limbs.reach[1, :]
    tilt = limbs.angles[1, :] + limbs.angles[2, :]
    return ca.vertcat(
        (u + links[0, :]) * sideways,
        -z * outward + u * force[2, :],
        links[2, :] * (ca.cos(tilt) * outward + ca.sin(tilt) * force[2, :]),
    )
