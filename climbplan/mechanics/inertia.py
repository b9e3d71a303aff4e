"""Inertia of a moving robot as a load: what its accelerations add to weight and contact forces.

At evenly spaced samples x_k a period h apart, accelerations are (x_{k+1} - 2 x_k + x_{k-1}) / h^2.
Angular velocities between samples are the rotation vectors of R_{k+1} R_k^T over h; their
difference over h is the angular acceleration alpha, their mean the velocity omega. With mass m and
inertia I about its centre, a link then adds the force -m a and the moment
-(I alpha + omega x I omega), by d'Alembert's principle. The robot rests before and after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.robots.link_masses import weight_torques
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain


@dataclass(frozen=True)
class CarriedMass:
    """A point mass that is fixed to the body."""

    mass: float  # [kg]
    offset: Array  # (3,) body frame [m]


@dataclass(frozen=True)
class LinkInertiaLoad:
    """The load by inertia at T samples, by d'Alembert's principle."""

    wrench: Array  # (T, 6) force and moment about the body origin, world frame [N, N m]
    torque: Array  # (T, N, J) about the joints, with the sign of J^T f [N m]


def compute_inertial_load(
    robot: Robot, com: Array, rpy: Array, angles: Array, *, period: float, carried: CarriedMass
) -> LinkInertiaLoad:
    """Return the inertial load of a motion.

    Where links weigh nothing, the robot's mass is a box of the size of its body.

    Args:
        robot: The robot.
        com: (T, 3) body origins [m].
        rpy: (T, 3) roll, pitch and yaw [rad].
        angles: (T, N, J) joint angles [rad, m].
        period: Between samples [s].
        carried: Mass that the body carries.
    """
    links, chain = robot.links, robot.mechanism
    rotation = rotation_world_body(rpy)
    if links is None or not isinstance(chain, SerialChain):
        body_mass, body_middle, body_inertia = robot.mass, np.zeros(3), _build_box_inertia(robot)
    else:
        body_mass, body_middle, body_inertia = (
            links.body_mass,
            links.body_middle,
            links.body_inertia,
        )
    wrench = np.zeros((len(com), 6))
    wrench[:, 3:] = -_compute_momentum_rate(rotation, body_inertia, period)
    for mass, middle in ((body_mass, body_middle), (carried.mass, carried.offset)):
        arm = rotation @ middle
        force = -mass * _differentiate_twice(com + arm, period)
        wrench += np.concatenate([force, np.cross(arm, force)], axis=1)
    if links is None or not isinstance(chain, SerialChain):
        return LinkInertiaLoad(wrench, np.zeros(angles.shape))
    pose, middles = chain.pose(angles), links.middles(chain, angles)
    arms = np.einsum("tij,tnlj->tnli", rotation, middles)
    force = -links.mass[..., None] * _differentiate_twice(com[:, None, None] + arms, period)
    turns = rotation[:, None, None] @ pose.turns
    moment = -_compute_momentum_rate(turns, links.inertia, period)
    wrench[:, :3] += force.sum(axis=(1, 2))
    wrench[:, 3:] += (np.cross(arms, force) + moment).sum(axis=(1, 2))
    force, moment = (np.einsum("tji,tnlj->tnli", rotation, v) for v in (force, moment))
    return LinkInertiaLoad(wrench, weight_torques(pose, middles, force, moment))


def _build_box_inertia(robot: Robot) -> Array:
    """Return the inertia (3, 3) of the robot's mass as a box of the size of its body [kg m^2]."""
    square = (np.ptp(robot.body_hull, axis=0) / 2) ** 2
    return np.diag(robot.mass / 3 * (square.sum() - square))


def _repeat_ends(values: Array) -> Array:
    """Return values (T + 2, ...) with the first and last ones twice."""
    return np.concatenate([values[:1], values, values[-1:]])


def _differentiate_twice(points: Array, period: float) -> Array:
    """Return the accelerations (T, ...) of points (T, ...)."""
    return np.diff(_repeat_ends(points), n=2, axis=0) / period**2


def _compute_momentum_rate(rotation: Array, inertia: Array, period: float) -> Array:
    """Return the change of angular momentum (T, ..., 3) of links that rotate [N m].

    Args:
        rotation: (T, ..., 3, 3) link to world.
        inertia: (..., 3, 3) of each link about its centre of mass, its own frame [kg m^2].
        period: Between samples [s].
    """
    padded = _repeat_ends(rotation)
    turn = padded[1:] @ np.swapaxes(padded[:-1], -1, -2)
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    velocity = vector.reshape(turn.shape[:-1]) / period  # (T + 1, ..., 3) between samples
    acceleration = np.diff(velocity, axis=0) / period
    mean = (velocity[1:] + velocity[:-1]) / 2
    world_inertia = rotation @ inertia @ np.swapaxes(rotation, -1, -2)
    return np.asarray(
        (world_inertia @ acceleration[..., None])[..., 0]
        + np.cross(mean, (world_inertia @ mean[..., None])[..., 0])
    )
