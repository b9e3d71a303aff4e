"""Gravity compensation of the limbs, whose weight the planner counts to the body.

A limb in the air hangs from its joints. Without feedforward its toe would land lower than planned
by weight over stiffness, and the robot would sink with every step.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.model.chain_limb import require_chain
from climbplan.climb.simulation.model.link_masses import select_link_masses
from climbplan.climb.simulation.model.mjcf import compute_link_mass
from climbplan.mechanics.equilibrium import link_torques
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.link_masses import weight_torques
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.motors import compute_assumed_stiffness, compute_motor_damping

_STEP = 1e-6  # [rad] of difference quotients


def compute_gravity_torques(plan: ClimbPlan, conditions: Conditions) -> Array:
    """Compute torques (T, N, J) that support the links' weight at the planned postures [N m].

    Those of prismatic joints are forces [N].
    """
    robot = plan.robot
    angles = compute_true_angles(plan, sample_instants(plan))
    rotation = rotation_world_body(plan.trajectory.rpy)
    if isinstance(robot.mechanism, FiveBar):
        return _differentiate_potential(
            robot, rotation, angles, compute_link_mass(robot, conditions)
        )
    masses, middles = _locate_links(plan, conditions, angles)
    gravity = -robot.gravity * rotation[:, 2, :]  # of a kilogram, in body axes (T, 3)
    weight = masses[..., None] * gravity[:, None, None]  # (T, N, link, 3)
    if robot.mechanism is not None:
        return -weight_torques(require_chain(robot).pose(angles), middles, weight)
    joints = joint_points_body(robot, angles)[:, :, :-1]
    # Power of the weight of link l by joint j <= l: axis . (arm x weight), or slide . weight
    arms = middles[:, :, None] - joints[:, :, :, None]  # (T, N, joint, link, 3)
    moment = np.cross(arms, weight[:, :, None])
    power = np.einsum("tnji,tnjli->tnjl", _compute_joint_axes(robot, angles), moment)
    return -np.triu(power).sum(axis=-1)  # links from the joint outward


def compute_inertia_torques(plan: ClimbPlan) -> Array:
    """Compute torques (T, N, J) that accelerate the links of a paced motion [N m]; zero of others.

    They are what stored torques of motors are beyond contact forces and the links' weight.
    """
    trajectory, robot = plan.trajectory, plan.robot
    if trajectory.torque is None:
        return np.zeros_like(trajectory.joint_command)
    angles = compute_true_angles(plan, sample_instants(plan))
    contact = (angles - trajectory.joint_command) / joint_softness(robot)
    contact = np.where(trajectory.contact[..., None], contact, 0.0)
    return contact + link_torques(robot, trajectory.rpy, angles) - trajectory.torque


def compute_speed_offsets(plan: ClimbPlan, conditions: Conditions) -> Array:
    """Compute offsets (T, N, J) of commands by which damped servos do not lag behind [rad].

    Servos with gain k and damping d to rest follow commands q + d/k dq/dt, as servos with a speed
    reference follow q.
    """
    angles = compute_true_angles(plan, sample_instants(plan))
    nominal = replace(conditions, damping=1.0, world=None)
    damping = compute_motor_damping(plan.robot, nominal)
    speed = conditions.speed * np.gradient(angles, plan.trajectory.time, axis=0)
    return damping / compute_assumed_stiffness(plan.robot, conditions) * speed


def compute_links_wrench(plan: ClimbPlan, conditions: Conditions) -> Array:
    """Compute the wrench (T, 6) about the body origin by the offset of the links' weight [N, N m].

    The force is zero, as the robot's whole mass counts to the body elsewhere.
    """
    rotation = rotation_world_body(plan.trajectory.rpy)
    angles = compute_true_angles(plan, sample_instants(plan))
    moment = compute_links_moment(plan, conditions, rotation, angles)
    return np.concatenate([np.zeros_like(moment), moment], axis=1)


def compute_links_moment(
    plan: ClimbPlan, conditions: Conditions, rotation: Array, angles: Array
) -> Array:
    """Compute the moment (T, 3) of the links' weight about the body origin, world frame [N m].

    Args:
        plan: The plan.
        conditions: Conditions, which state the links' mass.
        rotation: (T, 3, 3) body to world.
        angles: (T, N, J) joint angles.
    """
    masses, middles = _locate_links(plan, conditions, angles)
    links = np.einsum("tij,tnlj->tnli", rotation, middles)
    weight = masses[..., None] * np.array([0.0, 0.0, -plan.robot.gravity])
    moment = np.cross(links, weight).sum(axis=(1, 2))
    if (
        link_masses := select_link_masses(plan, conditions)
    ) is not None:  # whose body is off its origin, too
        weight = np.array([0.0, 0.0, -link_masses.body_mass * plan.robot.gravity])
        moment += np.cross(rotation @ link_masses.body_middle, weight)
    return moment


def _locate_links(plan: ClimbPlan, conditions: Conditions, angles: Array) -> tuple[Array, Array]:
    """Return masses (N, J) of links [kg] and their centers (T, N, J, 3), body frame [m]."""
    robot = plan.robot
    if (link_masses := select_link_masses(plan, conditions)) is not None:
        return link_masses.mass, link_masses.middles(require_chain(robot), angles)
    shape = robot.limb_count, robot.joint_count
    return np.full(shape, compute_link_mass(robot, conditions)), _compute_link_centers(
        robot, angles
    )


def _differentiate_potential(robot: Robot, rotation: Array, angles: Array, mass: float) -> Array:
    """Compute gravity torques (T, N, 3) of linkages by differences; mass: of a link [kg]."""
    gravity_force = -mass * robot.gravity * rotation[:, 2, :]  # the weight in body axes
    torque = np.zeros_like(angles)
    for joint in range(robot.joint_count):
        step = np.zeros(robot.joint_count)
        step[joint] = _STEP
        ahead, behind = (_compute_link_centers(robot, angles + sign * step) for sign in (1.0, -1.0))
        torque[..., joint] = -np.einsum(
            "tnli,ti->tn", (ahead - behind) / (2 * _STEP), gravity_force
        )
    return torque


def _compute_link_centers(robot: Robot, angles: Array) -> Array:
    """Compute the centers (T, N, J, 3) of the links, body frame [m]."""
    points = joint_points_body(robot, angles)
    begin = points[:, :, :-1]
    if isinstance(robot.mechanism, SerialChain):
        begin = robot.mechanism.pose(angles).places
    return np.asarray((begin + points[:, :, 1:]) / 2)


def _compute_joint_axes(robot: Robot, angles: Array) -> Array:
    """Compute the axes (T, N, 3, 3) of coxa, femur and tibia, body frame."""
    yaw = robot.mount_yaw + angles[..., 0]  # (T, N)
    # Coxa about z, femur and tibia lift outward
    up = np.broadcast_to([0.0, 0.0, 1.0], (*yaw.shape, 3))
    lift = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    return np.stack([up, lift, lift], axis=-2)
