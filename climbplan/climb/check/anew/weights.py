"""Where a robot's weight acts, from what the plan file says of its links: built anew."""

from __future__ import annotations

import numpy as np

from climbplan.climb.check.anew.chains import points_of_links
from climbplan.plans.check import Array
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


def weight_on(robot: Robot, axes: Array, angles: Array) -> Array:
    """(K, 6) force and moment about the body's origin [N, N m], world frame.

    axes: (K, 3, 3) of the body, as rows; angles: (K, N, J). The weight of a robot whose limbs weigh
    nothing acts in its origin.
    """
    weight = np.array([0.0, 0.0, -robot.mass * robot.gravity])
    out = np.zeros((len(axes), 6))
    out[:, :3] = weight
    links, chain = robot.links, robot.mechanism
    if links is None or not isinstance(chain, SerialChain):
        return out
    places = points_of_links(chain, angles, chain.joint_zero + links.middle)
    first = (links.mass[..., None] * places).sum(axis=(-3, -2))
    first = first + links.body_mass * links.body_middle
    arm = ((first / robot.mass)[:, None, :] @ axes)[:, 0]
    out[:, 3:] = np.cross(arm, weight)
    return out
