"""Directions of a limb's joints and of its last link, for what is mounted at its end."""

from __future__ import annotations

import numpy as np

from climbplan.robots.five_bar import FiveBar
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain


def joint_axes_body(robot: Robot, angles: Array) -> Array:
    """Turning velocity of the last link by joint speed, as rows (..., N, J, 3), body frame.

    Of serial limbs these are the unit axes of the joints.
    """
    if isinstance(robot.mechanism, FiveBar | SerialChain):
        return np.swapaxes(robot.mechanism.turning(angles), -1, -2)
    psi = robot.mount_yaw + angles[..., 0]
    zero = np.zeros_like(psi)
    up = np.stack([zero, zero, zero + 1.0], axis=-1)
    hinge = np.stack([np.sin(psi), -np.cos(psi), zero], axis=-1)
    return np.stack([up, hinge, hinge], axis=-2)


def last_link_body(robot: Robot, angles: Array) -> Array:
    """Rows x along the tibia, y across it in the limb's plane, z along its joint's axis.

    (..., N, 3, 3), body frame.
    """
    psi = robot.mount_yaw + angles[..., 0]
    if isinstance(robot.mechanism, FiveBar):
        tilt = robot.mechanism.plane(angles).tilt
    elif robot.mechanism is None:
        tilt = angles[..., 1] + angles[..., 2]
    else:
        raise TypeError("the last link of a chain of joints has no plane of its own")
    sin, cos = np.sin(tilt), np.cos(tilt)
    out = np.stack([np.cos(psi), np.sin(psi)], axis=-1)
    x = np.concatenate([sin[..., None] * out, -cos[..., None]], axis=-1)
    y = np.concatenate([cos[..., None] * out, sin[..., None]], axis=-1)
    return np.stack([x, y, np.cross(x, y)], axis=-2)
