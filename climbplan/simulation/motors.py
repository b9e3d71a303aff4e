"""Motors of a simulated robot: stiffness, damping, rotors and backlash of their joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot, dynamics_of
from climbplan.simulation.conditions import Conditions


def compute_motor_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) stiffness of the joints with the structure's give [N m/rad]."""
    compliance_share = robot.structural_compliance_share
    stiffness = np.asarray(robot.joint_stiffness * (1 - compliance_share) * conditions.gain)
    world = conditions.world
    return stiffness if world is None else stiffness * world.gain * world.stiffness


def compute_assumed_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) what whoever commands the joints takes it for [N m/rad]."""
    return compute_motor_stiffness(robot, replace(conditions, gain=1.0, world=None))


def compute_rotor_inertia(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) of motors behind their gears, as the joints feel it [kg m^2], [kg]."""
    robot_inertia = dynamics_of(robot).rotor_inertia
    if conditions.armature_value is not None:
        return np.full_like(robot_inertia, conditions.armature_value)
    return np.asarray(conditions.armature * robot_inertia)


def compute_motor_damping(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) derivative gains of the joints' servos [N m s/rad], [N s/m].

    Gains are a controller's: another rotor inertia does not change them.
    """
    robot_damping = dynamics_of(robot).damping
    if conditions.damping_value is not None:
        return np.full_like(robot_damping, conditions.damping_value)
    return np.asarray(conditions.damping * robot_damping)


def compute_joint_damping(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) of servos and of what turns in them [N m s/rad], [N s/m]."""
    return compute_motor_damping(robot, conditions) + compute_viscous_friction(robot, conditions)


def compute_viscous_friction(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) of bearings and gears [N m s/rad], [N s/m]."""
    return np.asarray(conditions.damping * dynamics_of(robot).viscous_friction)


def compute_max_torque(robot: Robot, conditions: Conditions) -> Array:
    """Return (N, J) largest torques of the motors [N m], [N]."""
    max_torque = robot.max_torque.copy()
    for motor in conditions.weak_motors:
        max_torque[motor.limb, motor.joint] *= motor.torque_fraction
    return max_torque


def compute_backlash(robot: Robot, conditions: Conditions) -> Array:
    """Return the backlash (N, J) of joints [rad], of sliding ones as many times `RADIAN` [m]."""
    backlash = np.full((robot.limb_count, robot.joint_count), conditions.backlash)
    total_backlash = backlash if conditions.world is None else backlash + conditions.world.backlash
    return np.asarray(total_backlash * robot.joint_unit)
