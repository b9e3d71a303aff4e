"""What motors must carry of the limbs' own weight, which the planner counts to the body.

A limb in the air hangs from its joints: without this part its toe comes down lower than planned by
weight over stiffness, for SiLVIA some 25 mm, and the robot sinks with every step.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.climb.simulation.model.chain_limb import chain_of
from climbplan.climb.simulation.model.link_masses import link_masses
from climbplan.climb.simulation.model.mjcf import link_mass
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.link_masses import weight_torques
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import Conditions

_STEP = 1e-6  # [rad] of difference quotients


def limb_weight_torques(plan: ClimbPlan, conditions: Conditions) -> Array:
    """(T, N, J) torques [N m] that hold the links' weight at the planned postures.

    Of joints that slide forces [N].
    """
    robot = plan.robot
    angles = true_angles(plan, sample_instants(plan))
    rotation = rotation_world_body(plan.trajectory.rpy)
    if isinstance(robot.mechanism, FiveBar):
        return _by_differences(robot, rotation, angles, link_mass(robot, conditions))
    masses, middles = _links(plan, conditions, angles)
    down = -robot.gravity * rotation[:, 2, :]  # of a kilogram, in body axes (T, 3)
    weight = masses[..., None] * down[:, None, None]  # (T, N, link, 3)
    if robot.mechanism is not None:
        return -weight_torques(chain_of(robot).pose(angles), middles, weight)
    joints = joint_points_body(robot, angles)[:, :, :-1]
    # Power of the weight of link l by joint j <= l: axis . (arm x weight), or slide . weight
    arms = middles[:, :, None] - joints[:, :, :, None]  # (T, N, joint, link, 3)
    moment = np.cross(arms, weight[:, :, None])
    power = np.einsum("tnji,tnjli->tnjl", _axes(robot, angles), moment)
    return -np.triu(power).sum(axis=-1)  # links from the joint outward


def limb_weight_wrench(plan: ClimbPlan, conditions: Conditions) -> Array:
    """(T, 6) moment about the body origin of the links' weight where it acts, no force.

    The robot's whole mass counts to the body elsewhere.
    """
    rotation = rotation_world_body(plan.trajectory.rpy)
    angles = true_angles(plan, sample_instants(plan))
    moment = links_moment(plan, conditions, rotation, angles)
    return np.concatenate([np.zeros_like(moment), moment], axis=1)


def links_moment(plan: ClimbPlan, conditions: Conditions, rotation: Array, angles: Array) -> Array:
    """(T, 3) moment of the links' weight about the origin of bodies turned by (T, 3, 3) [N m].

    angles: (T, N, J).
    """
    masses, middles = _links(plan, conditions, angles)
    links = np.einsum("tij,tnlj->tnli", rotation, middles)
    weight = masses[..., None] * np.array([0.0, 0.0, -plan.robot.gravity])
    moment = np.cross(links, weight).sum(axis=(1, 2))
    if (own := link_masses(plan, conditions)) is not None:  # whose body is off its origin, too
        weight = np.array([0.0, 0.0, -own.body_mass * plan.robot.gravity])
        moment += np.cross(rotation @ own.body_middle, weight)
    return moment


def _links(plan: ClimbPlan, conditions: Conditions, angles: Array) -> tuple[Array, Array]:
    """Masses (N, J) of links [kg], and where they act (T, N, J, 3) from the body [m]."""
    robot = plan.robot
    if (own := link_masses(plan, conditions)) is not None:
        return own.mass, own.middles(chain_of(robot), angles)
    shape = robot.limb_count, robot.joint_count
    return np.full(shape, link_mass(robot, conditions)), _middles(robot, angles)


def _by_differences(robot: Robot, rotation: Array, angles: Array, mass: float) -> Array:
    """(T, N, 3) torques of motors whose links of a mass [kg] a linkage moves as well."""
    down = -mass * robot.gravity * rotation[:, 2, :]  # the weight in body axes
    torque = np.zeros_like(angles)
    for joint in range(robot.joint_count):
        step = np.zeros(robot.joint_count)
        step[joint] = _STEP
        ahead, behind = (_middles(robot, angles + way * step) for way in (1.0, -1.0))
        torque[..., joint] = -np.einsum("tnli,ti->tn", (ahead - behind) / (2 * _STEP), down)
    return torque


def _middles(robot: Robot, angles: Array) -> Array:
    """(T, N, J, 3) middles of the links from the body."""
    points = joint_points_body(robot, angles)
    begin = points[:, :, :-1]
    if isinstance(robot.mechanism, SerialChain):
        begin = robot.mechanism.pose(angles).places
    return np.asarray((begin + points[:, :, 1:]) / 2)


def _axes(robot: Robot, angles: Array) -> Array:
    """Axes of coxa, femur and tibia in the body frame (T, N, 3, 3)."""
    yaw = robot.mount_yaw + angles[..., 0]  # (T, N)
    # Coxa about z, femur and tibia lift outward
    up = np.broadcast_to([0.0, 0.0, 1.0], (*yaw.shape, 3))
    lift = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    return np.stack([up, lift, lift], axis=-2)
