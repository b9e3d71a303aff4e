"""Weight of a robot and its links, from the data of the plan file."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import build_chains, move_link_points
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


def compute_link_torques(robot: Robot, axes: Array, angles: Array) -> Array:
    """Return torques (K, N, J) of the links' weight about their joints [N m], with the sign of J^T
    f.

    Args:
        robot: The robot.
        axes: (K, 3, 3) body axes as rows.
        angles: (K, N, J) joint angles [rad].
    """
    links, chain = robot.links, robot.mechanism
    torques = np.zeros(angles.shape)
    if links is None or not isinstance(chain, SerialChain):
        return torques
    link_centres = move_link_points(chain, angles, chain.joint_zero + links.middle)
    limbs = build_chains(chain, angles)
    down = -robot.gravity * axes[..., 2]  # world z by the body's axes
    for link in range(angles.shape[-1]):
        weight = links.mass[:, link, None] * down[:, None, :]  # (K, N, 3)
        for j in range(link + 1):
            lever_arm = link_centres[..., link, :] - limbs.joints[..., j, :]
            speed = np.cross(limbs.axes[..., j, :], lever_arm) + limbs.slides[..., j, :]
            torques[..., j] += (speed * weight).sum(axis=-1)
    if chain.drive is None:
        return torques
    return np.einsum("nij,kni->knj", chain.drive, torques)


def compute_weight_wrench(robot: Robot, axes: Array, angles: Array) -> Array:
    """Return the weight's force and moment (K, 6) about the body's origin [N, N m], world frame.

    The weight of a robot with massless limbs acts in its origin.

    Args:
        robot: The robot.
        axes: (K, 3, 3) body axes as rows.
        angles: (K, N, J) joint angles [rad].
    """
    weight = np.array([0.0, 0.0, -robot.mass * robot.gravity])
    wrench = np.zeros((len(axes), 6))
    wrench[:, :3] = weight
    links, chain = robot.links, robot.mechanism
    if links is None or not isinstance(chain, SerialChain):
        return wrench
    link_centres = move_link_points(chain, angles, chain.joint_zero + links.middle)
    mass_moment = (links.mass[..., None] * link_centres).sum(axis=(-3, -2))
    mass_moment = mass_moment + links.body_mass * links.body_middle
    mass_centre = ((mass_moment / robot.mass)[:, None, :] @ axes)[:, 0]
    wrench[:, 3:] = np.cross(mass_centre, weight)
    return wrench
