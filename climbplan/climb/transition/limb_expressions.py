"""A limb's closed-form inverse kinematics and torques as expressions, knee branch given.

The same formulas as in `robots.kinematics`, with rounding at full stretch cut off so that they stay
finite a little out of reach, where a row of the program says that the toe is too far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

_CUT = 1e-9  # of the cosine of the knee angle


@dataclass(frozen=True)
class LimbExpression:
    """One limb with its toe at a point."""

    angles: Any  # (3,) coxa, femur, tibia [rad], coxa not wrapped
    stretch: Any  # cosine of the knee's angle: within -1 and 1 if the toe is in reach
    radial: Any  # (2,) unit horizontal direction to the toe, body frame
    reach: Any  # (2,) horizontal distance beyond the coxa and height of the toe [m]


def limb_expression(
    shoulder: Any, links: Any, mount_yaw: Any, middle: Any, toe: Any, branch: Any
) -> LimbExpression:
    """Joint angles for a toe (3,) in the body frame; branch: -1 knee up, 1 knee down.

    middle: of the coxa's bounds [rad], to which its angle is wrapped.
    """
    offset = toe - shoulder
    distance = ca.sqrt(offset[0] ** 2 + offset[1] ** 2 + 1e-12)
    u, z = distance - links[0], offset[2]
    stretch = (u**2 + z**2 - links[1] ** 2 - links[2] ** 2) / (2 * links[1] * links[2])
    inside = ca.fmax(ca.fmin(stretch, 1 - _CUT), -1 + _CUT)
    beta = branch * ca.acos(inside)
    femur = ca.atan2(z, u) - ca.atan2(links[2] * ca.sin(beta), links[1] + links[2] * ca.cos(beta))
    # The angle from the middle of the coxa's bounds, where atan2 has no jump.
    heading = mount_yaw + middle
    along = offset[0] * ca.cos(heading) + offset[1] * ca.sin(heading)
    across = -offset[0] * ca.sin(heading) + offset[1] * ca.cos(heading)
    coxa = middle + ca.atan2(across, along)
    angles = ca.vertcat(coxa, femur, beta + ca.pi / 2)
    return LimbExpression(angles, stretch, offset[:2] / distance, ca.vertcat(u, z))


def torques(limb: LimbExpression, links: Any, force: Any) -> Any:
    """Joint torques J^T f (3,) of a force (3,) on the toe, body frame."""
    outward = limb.radial[0] * force[0] + limb.radial[1] * force[1]
    sideways = limb.radial[0] * force[1] - limb.radial[1] * force[0]
    u, z = limb.reach[0], limb.reach[1]
    tilt = limb.angles[1] + limb.angles[2]
    return ca.vertcat(
        (u + links[0]) * sideways,
        -z * outward + u * force[2],
        links[2] * (ca.cos(tilt) * outward + ca.sin(tilt) * force[2]),
    )
