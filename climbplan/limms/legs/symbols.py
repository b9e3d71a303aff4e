"""Symbolic closed-form joint angles and speeds of a standing leg.

The first end stands upright at the foothold, the last is latched to a side of the box, which does
not turn. So all follows from the centre of the box relative to the foothold, and its velocity.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.limms.scene.phases import SupportModule
from climbplan.limms.schema.module import ModuleSpec

MIN_AXIS_DISTANCE = 0.05  # [m] of the wrist from the first axis, a singularity
MIN_BEND = (0.12, 0.08)  # [rad] of elbow and wrist
_CLIP = 0.9995  # of cosines, so that angles exist out of reach, where a constraint is violated


class LimitBounds(NamedTuple):
    """Bounds on the `limits` (4,) of a leg."""

    lower: Array
    upper: Array


def build_leg_function(module: ModuleSpec, limb: SupportModule, box_size: Array) -> ca.Function:
    """Build the inverse kinematics of a standing leg.

    Returns:
        A function of centre - foothold (3) [m] and velocity of the box (3) [m/s]. Its values are
        angles (6) [rad] with rolls in (-pi, pi], speeds (6) [rad/s], and limits (4). Limits are the
        squared distance of the wrist from the first axis [m^2] and the cosines of elbow (joint 3),
        joint 2 and wrist (joint 5), bounded by `compute_limit_bounds`.
    """
    a = module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    normal = SIDE_NORMALS[limb.side]
    shoulder, elbow, flip = limb.branch
    offset, velocity = ca.SX.sym("over", 3), ca.SX.sym("velocity", 3)
    wrist = offset + ca.DM(normal * (abs(normal) @ box_size / 2 + a[5] + a[6]))
    x, y, height = wrist[0], wrist[1], wrist[2] - a[0] - a[1]
    square = x**2 + y**2
    reach = shoulder * ca.sqrt(square + 1e-12)
    yaw = ca.atan2(shoulder * y, shoulder * x)
    cosine = (square + height**2 - upper**2 - fore**2) / (2 * upper * fore)
    bend = elbow * ca.acos(ca.fmax(ca.fmin(cosine, _CLIP), -_CLIP))
    forearm_angle = ca.atan2(fore * ca.sin(bend), upper + fore * ca.cos(bend))
    pitch = ca.atan2(reach, height) - forearm_angle
    c, s = ca.cos(yaw), ca.sin(yaw)
    yaw_rotation = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    c, s = ca.cos(pitch + bend), ca.sin(pitch + bend)
    pitch_rotation = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
    remaining = (yaw_rotation @ pitch_rotation).T @ ca.DM(limb.box_rotation)  # Rz(q4) Ry(q5) Rz(q6)
    inner = ca.fmax(ca.fmin(remaining[2, 2], _CLIP), -_CLIP)
    angles = ca.vertcat(
        yaw,
        pitch,
        bend,
        ca.atan2(flip * remaining[1, 2], flip * remaining[0, 2]),
        flip * ca.acos(inner),
        ca.atan2(flip * remaining[2, 1], -flip * remaining[2, 0]),
    )
    limits = ca.vertcat(square, cosine, ca.cos(pitch), remaining[2, 2])
    speeds = ca.jtimes(angles, offset, velocity)
    return ca.Function("leg", [offset, velocity], [angles, speeds, limits])


def compute_limit_bounds(module: ModuleSpec, margin: float) -> LimitBounds:
    """Return bounds of the limits of `build_leg_function`, `margin` [rad] inside joint ranges."""
    bound = np.minimum(np.array(module.joint_range) - margin, np.pi - 0.02)
    return LimitBounds(
        np.array([MIN_AXIS_DISTANCE**2, np.cos(bound[2]), np.cos(bound[1]), np.cos(bound[4])]),
        np.array([np.inf, np.cos(MIN_BEND[0]), np.inf, np.cos(MIN_BEND[1])]),
    )
