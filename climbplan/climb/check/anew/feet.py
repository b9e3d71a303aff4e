"""Feet of finite size: where limbs touch, and limbs that end there.

A sphere of radius r about a toe touches a surface of normal n at toe - r n. It rolls: while the
body moves a little, the point of the last link that touches stands still.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import rotate_to_zero
from climbplan.climb.check.anew.kinematics import Limbs, require_chain
from climbplan.robots.model import Robot


def compute_contact_arm(robot: Robot, normal: Array) -> Array:
    """Return vectors (..., N, 3) from toes to their contact points [m], zero for point feet.

    normal: (..., N, 3) surface normals at the toes.
    """
    radius = 0.0 if robot.foot is None else robot.foot.radius
    return -radius * normal


def move_toes_to_contacts(limbs: Limbs, arm: Array) -> Limbs:
    """Return the limbs with contact points as toes, so that velocities and torques are those of
    contacts.
    """
    return replace(limbs, toe=limbs.toe + arm) if arm.any() else limbs


def build_rolling_robot(robot: Robot, axes: Array, angles: Array, normal: Array) -> Robot:
    """Return the robot whose chains end in the contact points of its feet at angles (K, N, J).

    Point feet and flat feet do not roll: their robot is returned unchanged.

    Args:
        robot: The robot.
        axes: (K, 3, 3) body axes as rows.
        angles: (K, N, J) joint angles [rad].
        normal: (K, N, 3) surface normals.
    """
    if robot.foot is None or robot.sole is not None:
        return robot
    chain = require_chain(robot)
    local = np.einsum("kij,knj->kni", axes, compute_contact_arm(robot, normal))
    toes = chain.toe_zero + rotate_to_zero(chain, angles, local)  # (K, N, 3), one chain an instant
    return replace(robot, mechanism=replace(chain, toe_zero=toes))
