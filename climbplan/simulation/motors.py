"""What the motors of a simulated run are: stiffness, damping, rotors and play of their joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot, dynamics_of
from climbplan.simulation.conditions import Conditions


def motor_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) stiffness of the joints with the structure's give [N m/rad]."""
    share = robot.structural_compliance_share
    stiffness = np.asarray(robot.joint_stiffness * (1 - share) * conditions.gain)
    world = conditions.world
    return stiffness if world is None else stiffness * world.gain * world.stiffness


def believed_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) what whoever commands the joints takes it for [N m/rad]."""
    return motor_stiffness(robot, replace(conditions, gain=1.0, world=None))


def rotor_inertia(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) of motors behind their gears, as the joints feel it [kg m^2], [kg]."""
    own = dynamics_of(robot).rotor_inertia
    if conditions.armature_value is not None:
        return np.full_like(own, conditions.armature_value)
    return np.asarray(conditions.armature * own)


def motor_damping(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) derivative gains of the joints' servos [N m s/rad], [N s/m].

    Gains are a controller's: another rotor inertia does not change them.
    """
    own = dynamics_of(robot).damping
    if conditions.damping_value is not None:
        return np.full_like(own, conditions.damping_value)
    return np.asarray(conditions.damping * own)


def joint_damping(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) of servos and of what turns in them [N m s/rad], [N s/m]."""
    return motor_damping(robot, conditions) + viscous_friction(robot, conditions)


def viscous_friction(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) of bearings and gears [N m s/rad], [N s/m]."""
    return np.asarray(conditions.damping * dynamics_of(robot).viscous_friction)


def plays(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) play of the joints [rad], of those that slide as many times `RADIAN` [m]."""
    own = np.full((robot.limb_count, robot.joint_count), conditions.backlash)
    both = own if conditions.world is None else own + conditions.world.backlash
    return np.asarray(both * robot.joint_unit)
