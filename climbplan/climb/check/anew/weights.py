"""Where a robot's weight acts, from what the plan file says of its links: built anew."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import chains_at, points_of_links
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain


def link_torques(robot: Robot, axes: Array, angles: Array) -> Array:
    """(K, N, J) torques of the links' own weight about their joints [N m], with the sign of J^T f.

    axes: (K, 3, 3) of the body, as rows; angles: (K, N, J).
    """
    links, chain = robot.links, robot.mechanism
    out = np.zeros(angles.shape)
    if links is None or not isinstance(chain, SerialChain):
        return out
    places = points_of_links(chain, angles, chain.joint_zero + links.middle)
    limbs = chains_at(chain, angles)
    down = -robot.gravity * axes[..., 2]  # world z by the body's axes
    for link in range(angles.shape[-1]):
        weight = links.mass[:, link, None] * down[:, None, :]  # (K, N, 3)
        for j in range(link + 1):
            arm = places[..., link, :] - limbs.joints[..., j, :]
            speed = np.cross(limbs.axes[..., j, :], arm) + limbs.slides[..., j, :]
            out[..., j] += (speed * weight).sum(axis=-1)
    if chain.drive is None:
        return out
    return np.einsum("nij,kni->knj", chain.drive, out)


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
