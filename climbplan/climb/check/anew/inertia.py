"""Inertia of the links of a moving robot, from the samples of the plan file.

Accelerations are second differences of the samples. The angular momentum of a link changes by
I alpha + omega x I omega, with the rotation vectors between samples as angular velocities. The
robot rests before the first sample and after the last one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import build_chains, move_link_points
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain

_SMALL_ANGLE = 1e-6  # [rad] below which a rotation vector is its antisymmetric part


@dataclass(frozen=True)
class Inertia:
    """Loads of a robot's inertia at T samples, by d'Alembert's principle."""

    wrench: Array  # (T, 6) about the body's origin, world frame [N, N m]
    torque: Array  # (T, N, J) about the joints, with the sign of J^T f [N m]


def compute_inertia(
    robot: Robot,
    com: Array,
    axes: Array,
    angles: Array,
    *,
    step: float,
    payload: tuple[float, Array],
) -> Inertia:
    """Return the inertial load of a motion.

    Args:
        robot: The robot; where its links weigh nothing its mass is a box as large as its body.
        com: (T, 3) body origins [m].
        axes: (T, 3, 3) body axes as rows.
        angles: (T, N, J) joint angles [rad].
        step: Time between samples [s].
        payload: Mass [kg] on the body, and where it is in the body frame (3,) [m].
    """
    links, chain = robot.links, robot.mechanism
    masses = [(robot.mass, np.zeros(3)), payload]
    body_inertia = _compute_box(robot.body_hull, robot.mass)
    if links is not None:
        masses[0] = links.body_mass, links.body_middle
        body_inertia = links.body_inertia
    wrench = np.zeros((len(com), 6))
    for mass, place in masses:
        arm = place @ axes
        force = -mass * _differentiate(com + arm, step)
        wrench[:, :3] += force
        wrench[:, 3:] += np.cross(arm, force)
    wrench[:, 3:] -= _measure_momentum_change(axes, body_inertia, step)
    torque = np.zeros(angles.shape)
    if links is None or not isinstance(chain, SerialChain):
        return Inertia(wrench, torque)
    limbs = build_chains(chain, angles)
    turn = axes[:, None, None]
    centres = move_link_points(chain, angles, chain.joint_zero + links.middle)
    # The body's axes, carried along by each link, are the columns of its rotation
    origin = move_link_points(chain, angles, chain.joint_zero)
    carried = [move_link_points(chain, angles, chain.joint_zero + e) - origin for e in np.eye(3)]
    link_axes = np.stack(carried, axis=-2) @ turn  # (T, N, J, 3, 3) rows, world
    arms = (centres[..., None, :] @ turn)[..., 0, :]
    force = -links.mass[..., None] * _differentiate(com[:, None, None] + arms, step)
    moment = -_measure_momentum_change(link_axes, links.inertia, step)
    wrench[:, :3] += force.sum(axis=(1, 2))
    wrench[:, 3:] += (np.cross(arms, force) + moment).sum(axis=(1, 2))
    joints, joint_axes, slides = (
        (v[..., None, :] @ turn)[..., 0, :] for v in (limbs.joints, limbs.axes, limbs.slides)
    )
    for link in range(angles.shape[-1]):
        for j in range(link + 1):
            lever_arm = arms[..., link, :] - joints[..., j, :]
            axis = joint_axes[..., j, :]
            speed = np.cross(axis, lever_arm) + slides[..., j, :]
            power = speed * force[..., link, :] + axis * moment[..., link, :]
            torque[..., j] += power.sum(axis=-1)
    if limbs.drive is not None:
        torque = np.einsum("nij,kni->knj", limbs.drive, torque)
    return Inertia(wrench, torque)


def _compute_box(corners: Array, mass: float) -> Array:
    """Return the inertia (3, 3) of an even box with corners (8, 3) about its middle [kg m^2]."""
    square = (corners.max(axis=0) - corners.min(axis=0)) ** 2
    return np.diag(mass / 12 * (square.sum() - square))


def _differentiate(points: Array, step: float) -> Array:
    """Return second differences in time (T, ...) of points (T, ...), at rest at both ends."""
    change = np.diff(points, axis=0)
    still = np.zeros_like(points[:1])
    after, before = np.append(change, still, axis=0), np.append(still, change, axis=0)
    return np.asarray((after - before) / step**2)


def _measure_momentum_change(axes: Array, inertia: Array, step: float) -> Array:
    """Return the rates of angular momentum (T, ..., 3) of links with axes (T, ..., 3, 3) as rows.

    inertia: (..., 3, 3) about the centres of mass, in the frames of the links.
    """
    rotation = np.swapaxes(axes, -1, -2)
    turn = rotation[1:] @ axes[:-1]
    speed = _measure_rotation_vectors(turn) / step
    still = np.zeros_like(speed[:1])
    after, before = np.append(speed, still, axis=0), np.append(still, speed, axis=0)
    world_inertia = rotation @ inertia @ axes
    mean = (after + before) / 2
    gyroscopic = np.cross(mean, np.einsum("...ij,...j->...i", world_inertia, mean))
    angular = np.einsum("...ij,...j->...i", world_inertia, (after - before) / step)
    return np.asarray(angular + gyroscopic)


def _measure_rotation_vectors(turn: Array) -> Array:
    """Return the rotation vectors (..., 3) of small rotations (..., 3, 3), below half a turn."""
    odd = turn - np.swapaxes(turn, -1, -2)
    sine_axis = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1) / 2
    sine = np.linalg.norm(sine_axis, axis=-1, keepdims=True)
    cosine = (np.trace(turn, axis1=-2, axis2=-1)[..., None] - 1) / 2
    angle = np.arctan2(sine, cosine)
    return np.where(sine > _SMALL_ANGLE, sine_axis * angle / np.maximum(sine, 1e-300), sine_axis)
