"""Newton-Euler recursion along a module: the inertial loads of its links.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5.3, in world coordinates. Velocities
and accelerations propagate from the held end outwards; then force and moment of each link about its
centre of mass follow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.inertia import LinkBodies
from climbplan.limms.scene.limms_scene import GRAVITY, Points

# Joint k lies at point k + 1; its axis is this column of the frames on both sides of it
JOINT_COLUMN = (2, 1, 1, 2, 1, 2)


class EndMotion(NamedTuple):
    """The motion of an end of a module: all (M, 3), world frame."""

    angular_velocity: Array  # angular velocity [rad/s]
    angular_acceleration: Array  # angular acceleration [rad/s^2]
    acceleration: Array  # of the point [m/s^2]


class InertialLoad(NamedTuple):
    """The loads that the motion of a module's links requires (M samples), world frame."""

    force: Array  # (M, 7, 3) mass times (acceleration - gravity) [N]
    moment: Array  # (M, 7, 3) about each link's COM [N m]
    com: Array  # (M, 7, 3) [m]
    ends: tuple[EndMotion, EndMotion]  # of first and last end


def create_rest_motion(count: int) -> EndMotion:
    """Return the motion of an end that rests."""
    return EndMotion(*(np.zeros((count, 3)) for _ in range(3)))


def compute_demand(
    bodies: LinkBodies,
    points: Points,
    root: int,
    root_motion: EndMotion,
    rates: Array,
    accelerations: Array,
) -> InertialLoad:
    """Compute the inertial loads of a module whose end `root` moves as given.

    Args:
        bodies: Masses of the links.
        points: Points of the module (M).
        root: The held end, 0 first or 1 last.
        root_motion: Its motion.
        rates: Joint speeds (M, 6) [rad/s].
        accelerations: Joint accelerations (M, 6) [rad/s^2].
    """
    count = len(rates)
    force, moment, com = (np.empty((count, 7, 3)) for _ in range(3))
    angular_velocity, angular_acceleration, acceleration = root_motion
    order = range(7) if root == 0 else range(6, -1, -1)
    for k in order:
        frame = points.rotation[:, k]
        if k != order[0]:
            joint = k - 1 if root == 0 else k
            sign = 1.0 if root == 0 else -1.0
            axis = frame[:, :, JOINT_COLUMN[joint]]
            rate, joint_acceleration = (
                sign * rates[:, joint, None],
                sign * accelerations[:, joint, None],
            )
            angular_acceleration = (
                angular_acceleration
                + axis * joint_acceleration
                + np.cross(angular_velocity, axis) * rate
            )
            angular_velocity = angular_velocity + axis * rate
        near_point, far_point = (k, k + 1) if root == 0 else (k + 1, k)
        link_axis = frame[:, :, 2]
        com[:, k] = points.position[:, k] + bodies.com[k] * link_axis
        offset = com[:, k] - points.position[:, near_point]
        com_acceleration = acceleration + _rigid_acceleration(
            angular_velocity, angular_acceleration, offset
        )
        force[:, k] = bodies.mass[k] * (com_acceleration + np.array([0.0, 0.0, GRAVITY]))
        moment[:, k] = _momentum_rate(
            bodies.transverse_inertia[k],
            bodies.axial_inertia[k],
            link_axis,
            angular_velocity,
            angular_acceleration,
        )
        step = points.position[:, far_point] - points.position[:, near_point]
        acceleration = acceleration + _rigid_acceleration(
            angular_velocity, angular_acceleration, step
        )
    free_motion = EndMotion(angular_velocity, angular_acceleration, acceleration)
    return InertialLoad(
        force, moment, com, (root_motion, free_motion) if root == 0 else (free_motion, root_motion)
    )


def sum_demand(load: InertialLoad, reference: Array) -> tuple[Array, Array]:
    """Return force and moment (M, 3) that a whole module requires, about points (M, 3)."""
    lever_arms = load.com - reference[:, None]
    moment = (load.moment + np.cross(lever_arms, load.force)).sum(axis=1)
    return load.force.sum(axis=1), moment


def compute_joint_torques(load: InertialLoad, points: Points, force: Array, moment: Array) -> Array:
    """Return torques (M, 6) of all joints with a wrench at the last end [N m]."""
    torque = np.empty((len(force), 6))
    for j in range(6):
        joint = points.position[:, j + 1]
        lever_arms = load.com[:, j + 1 :] - joint[:, None]
        outer_moments = load.moment[:, j + 1 :] + np.cross(lever_arms, load.force[:, j + 1 :])
        applied_moment = moment + np.cross(points.position[:, 7] - joint, force)
        axis = points.rotation[:, j, :, JOINT_COLUMN[j]]
        torque[:, j] = ((outer_moments.sum(axis=1) - applied_moment) * axis).sum(axis=1)
    return torque


def _rigid_acceleration(
    angular_velocity: Array, angular_acceleration: Array, offset: Array
) -> Array:
    """Return the acceleration of a point of a rotating body relative to its origin."""
    acceleration: Array = np.cross(angular_acceleration, offset) + np.cross(
        angular_velocity, np.cross(angular_velocity, offset)
    )
    return acceleration


def _momentum_rate(
    transverse: float,
    axial: float,
    axis: Array,
    angular_velocity: Array,
    angular_acceleration: Array,
) -> Array:
    """Return the rate of angular momentum (M, 3) of an axisymmetric body: I a + w x I w."""

    def inertia(vector: Array) -> Array:
        axial_part = (vector * axis).sum(axis=1, keepdims=True)
        applied: Array = transverse * vector + (axial - transverse) * axial_part * axis
        return applied

    moment: Array = inertia(angular_acceleration) + np.cross(
        angular_velocity, inertia(angular_velocity)
    )
    return moment
