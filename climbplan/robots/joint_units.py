"""Format angles, torques and speeds of joints with their units: degrees and N m, or mm and N."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot


def format_joint_position(
    robot: Robot, limb: int, joint: int, amount: float, digits: str = ".1f"
) -> str:
    """Return an angle [rad] as "3.0 deg", or a length [m] of a prismatic joint as "12.0 mm"."""
    if robot.slides[limb, joint]:
        return f"{1e3 * amount:{digits}} mm"
    return f"{np.rad2deg(amount):{digits}} deg"


def torque_unit(robot: Robot, limb: int, joint: int) -> str:
    """Return the unit of a joint's torque or force limit."""
    return "N" if robot.slides[limb, joint] else "N m"


def speed_unit(robot: Robot, limb: int, joint: int) -> str:
    """Return the unit of a joint's speed limit."""
    return "m/s" if robot.slides[limb, joint] else "rad/s"


def stiffness_unit(robot: Robot, limb: int, joint: int) -> str:
    """Return the unit of a joint's stiffness."""
    return "N/m" if robot.slides[limb, joint] else "N m/rad"


def format_bound_margin(robot: Robot, beyond: Array) -> str:
    """Return how far the joint nearest to its bounds is inside them.

    beyond: (..., N, J) distances past the bounds, negative inside [rad, m].
    """
    if not robot.slides.any():
        return f"{np.rad2deg(-beyond.max()):.1f} deg"
    worst = (beyond / robot.joint_unit).reshape(-1, robot.slides.size).argmax()
    limb, joint = divmod(int(worst % robot.slides.size), robot.joint_count)
    return format_joint_position(robot, limb, joint, -float(beyond.reshape(-1)[worst]))


def format_largest_torques(robot: Robot, torque: Array) -> str:
    """Return the largest of torques (..., N, J): "12.3 N m", and "45.6 N" of slides.

    NaN is left out.
    """
    size = np.nan_to_num(np.abs(torque))
    slides = robot.slides & robot.has_joint
    turning = f"{float(np.where(slides, 0.0, size).max(initial=0.0)):.1f} N m"
    if not slides.any():
        return turning
    return f"{turning}, {float(np.where(slides, size, 0.0).max(initial=0.0)):.1f} N"
