"""D gains and update rates with which joints of a climbing robot settle under their P gains.

A limb in the air is the hardest case for a controller of a fixed rate: it is the lightest thing
that its motors move. Its inertia about each joint, with that of the rotor, gives critical damping,
and the natural frequency that the rate has to be well above.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.model import motor_damping, motor_stiffness

EFFORT_RATE = 500.0  # [Hz] at which P and D gains on torques are computed at least
_STEPS = 4.0  # of a controller within 1 / natural frequency
_ROUND = 100.0  # [Hz]
_MOST_RATE = 2000.0  # [Hz]


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


def critical_damping(inertia: Array, gain: Array) -> Array:
    """Return D gains [N m s/rad] of critical damping for P gains [N m/rad]."""
    return np.asarray(2.0 * np.sqrt(inertia * np.maximum(gain, 0.0)))


def update_rate(damping: Array, gain: Array) -> float:
    """Return the rate [Hz] of a controller that computes torques of these gains (J,)."""
    frequency = np.divide(2.0 * gain, damping, out=np.zeros_like(gain), where=damping > 0)
    needed = _STEPS * float(frequency.max(initial=0.0))
    return float(np.clip(_ROUND * np.ceil(needed / _ROUND), EFFORT_RATE, _MOST_RATE))
