"""What limbs in the air weigh on their motors."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.motors import motor_damping, motor_stiffness


def joint_inertia(robot: Robot, angles: Array) -> Array:
    """Return the least inertia (N, J) of limbs in the air about their joints [kg m^2, kg].

    Links from a joint outward, at angles (T, N, J); what motors are assumed to turn with (rotors)
    where limbs weigh nothing.
    """
    chain, links = robot.mechanism, robot.links
    if links is None or not isinstance(chain, SerialChain):
        damping, stiffness = motor_damping(robot, NOMINAL), motor_stiffness(robot, NOMINAL)
        return np.asarray(damping**2 / (4 * stiffness))
    pose = chain.pose(angles)
    arms = links.middles(chain, angles)[..., None, :, :] - pose.joints[..., :, None, :]
    outward = np.triu(np.ones((robot.joint_count, robot.joint_count)))[..., None]  # (joint, link)
    moving = np.cross(pose.axes[..., :, None, :], arms)  # (T, N, joint, link, 3)
    if pose.slides is not None:
        moving = moving + pose.slides[..., :, None, :]
    turning = np.broadcast_to(pose.axes[..., :, None, :], moving.shape)
    moving, turning = moving * outward, turning * outward
    if pose.drive is not None:  # joints that mimic others move with them
        moving, turning = (
            np.einsum("nji,tnjlk->tnilk", pose.drive, part) for part in (moving, turning)
        )
    inertia = pose.turns @ links.inertia @ np.swapaxes(pose.turns, -1, -2)  # (T, N, link, 3, 3)
    energy = links.mass[:, None, :] * (moving**2).sum(axis=-1)
    energy += np.einsum("tnjli,tnlik,tnjlk->tnjl", turning, inertia, turning)
    return np.asarray(energy.sum(axis=-1).min(axis=0))
