"""A standing leg in symbols: its joint angles and speeds in closed form.

The first end stands upright at the foothold, the last is latched to a side of the box, which does
not turn: everything follows from the box's centre over the foothold and its velocity.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.limms.scene.phases import Limb
from climbplan.limms.schema.module import ModuleSpec

OFF_AXIS = 0.05  # [m] of the wrist from the first axis, at least: branches meet there
BENT = (0.12, 0.08)  # [rad] of elbow and wrist, at least
_CLIP = 0.9995  # of cosines: what is out of reach has angles too, and a constraint that says so


class Box(NamedTuple):
    """Least and largest values of `limits` (4,) of a leg."""

    lower: Array
    upper: Array


def leg_function(module: ModuleSpec, limb: Limb, box_size: Array) -> ca.Function:
    """Angles (6) [rad], speeds (6) [rad/s] and limits (4) of a leg from centre - foothold (3) [m]
    and the box's velocity (3) [m/s].

    Limits, to be held within `limits_of`: squared distance of the wrist from the first axis [m^2];
    cosines of the elbow (joint 3), of joint 2, and of the wrist (joint 5). Angles of rolls are
    in (-pi, pi].
    """
    a = module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    normal = SIDE_NORMALS[limb.side]
    shoulder, elbow, flip = limb.branch
    over, velocity = ca.SX.sym("over", 3), ca.SX.sym("velocity", 3)
    wrist = over + ca.DM(normal * (abs(normal) @ box_size / 2 + a[5] + a[6]))
    x, y, height = wrist[0], wrist[1], wrist[2] - a[0] - a[1]
    flat = x**2 + y**2
    reach = shoulder * ca.sqrt(flat + 1e-12)
    yaw = ca.atan2(shoulder * y, shoulder * x)
    cosine = (flat + height**2 - upper**2 - fore**2) / (2 * upper * fore)
    bend = elbow * ca.acos(ca.fmax(ca.fmin(cosine, _CLIP), -_CLIP))
    behind = ca.atan2(fore * ca.sin(bend), upper + fore * ca.cos(bend))
    pitch = ca.atan2(reach, height) - behind
    c, s = ca.cos(yaw), ca.sin(yaw)
    turn = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    c, s = ca.cos(pitch + bend), ca.sin(pitch + bend)
    lean = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
    left = (turn @ lean).T @ ca.DM(limb.box_rotation)  # Rz(q4) Ry(q5) Rz(q6)
    inner = ca.fmax(ca.fmin(left[2, 2], _CLIP), -_CLIP)
    angles = ca.vertcat(
        yaw,
        pitch,
        bend,
        ca.atan2(flip * left[1, 2], flip * left[0, 2]),
        flip * ca.acos(inner),
        ca.atan2(flip * left[2, 1], -flip * left[2, 0]),
    )
    limits = ca.vertcat(flat, cosine, ca.cos(pitch), left[2, 2])
    speeds = ca.jtimes(angles, over, velocity)
    return ca.Function("leg", [over, velocity], [angles, speeds, limits])


def limits_of(module: ModuleSpec, margin: float) -> Box:
    """Bounds of `leg_function`'s limits, `margin` [rad] inside the joints' ranges."""
    bound = np.minimum(np.array(module.joint_range) - margin, np.pi - 0.02)
    return Box(
        np.array([OFF_AXIS**2, np.cos(bound[2]), np.cos(bound[1]), np.cos(bound[4])]),
        np.array([np.inf, np.cos(BENT[0]), np.inf, np.cos(BENT[1])]),
    )
