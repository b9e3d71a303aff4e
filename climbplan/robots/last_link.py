"""Directions of a limb's joints and of its last link, for what is mounted at its end."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot


def joint_axes_body(robot: Robot, angles: Array) -> Array:
    """Return the angular velocity of the last link by joint speed, rows (..., N, J, 3), body frame.

    Of serial limbs these are the unit axes of the joints.
    """
    return np.swapaxes(robot.limbs.turning(angles), -1, -2)


def last_link_body(robot: Robot, angles: Array) -> Array:
    """Return rows x along the last link, y across it, z along its joint's axis (..., N, 3, 3)."""
    return robot.limbs.last_link(angles)
