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
    """From toes to where they touch (..., N, 3) [m], by the normals under them; zero for points."""
    radius = 0.0 if robot.foot is None else robot.foot.radius
    return -radius * normal


def move_toes_to_contacts(limbs: Limbs, arm: Array) -> Limbs:
    """Limbs whose toes are the points that touch, so that velocities and torques are theirs."""
    return replace(limbs, toe=limbs.toe + arm) if arm.any() else limbs


def build_rolling_robot(robot: Robot, axes: Array, angles: Array, normal: Array) -> Robot:
    """The robot whose chains end in the points of its feet that touch at angles (K, N, J).

    axes: (K, 3, 3) of the body, normal: (K, N, 3) of the surfaces. The robot itself for points, and
    for flat feet, which do not roll.
    """
    if robot.foot is None or robot.sole is not None:
        return robot
    chain = require_chain(robot)
    local = np.einsum("kij,knj->kni", axes, compute_contact_arm(robot, normal))
    toes = chain.toe_zero + rotate_to_zero(chain, angles, local)  # (K, N, 3), one chain an instant
    return replace(robot, mechanism=replace(chain, toe_zero=toes))
