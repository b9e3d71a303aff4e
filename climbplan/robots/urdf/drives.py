"""Actuators of a robot from a URDF: limits, stiffness, rotor inertia, damping and friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.joint_dynamics import (
    JointDynamics,
    default_damping,
    default_rotor_inertia,
)
from climbplan.schema.robots.urdf.robot import UrdfRobot

JointNames = Sequence[tuple[str, ...]]  # joints of each leg, from base to toe


def pad_to_legs(width: int, rows: Sequence[Sequence[float]], empty: float) -> Array:
    """Return rows as (N, J), shorter ones padded in front: their first joints do not exist.

    Args:
        width: J, joints of the longest leg.
        rows: Values of the joints of N legs.
        empty: Value of joints that do not exist.
    """
    return np.array([[empty] * (width - len(row)) + list(row) for row in rows])


def read_joint_limits(
    robot: UrdfRobot, legs: JointNames, width: int, key: str, attribute: str
) -> Array:
    """Return limits (N, J): the section's, else the URDF's.

    Args:
        robot: The section and its URDF.
        legs: Names of the joints of N legs, from base to toe.
        width: J, joints of the longest leg.
        key: Key of the section.
        attribute: Attribute of the URDF's joint.
    """
    sections = robot.spec.joints

    def limit(joint: str) -> float:
        if robot.tree.joints[joint].mimic is not None:  # its motor is that of another joint
            return 1.0
        stated = vars(sections[joint])[key] if joint in sections else None
        return float(stated or vars(robot.tree.joints[joint])[attribute])

    return _evaluate_joints(legs, width, limit, 1.0)


def read_joint_stiffness(robot: UrdfRobot, legs: JointNames, width: int) -> Array:
    """Return stiffness (N, J) under position control [N m/rad]: a joint's own, else the robot's.

    Args:
        robot: The section and its URDF.
        legs: Names of the joints of N legs, from base to toe.
        width: J, joints of the longest leg.
    """
    sections, spec = robot.spec.joints, robot.spec

    def stiffness(joint: str) -> float:
        stated = sections[joint].stiffness if joint in sections else None
        slides = robot.tree.joints[joint].slides
        return stated or (spec.slide_stiffness if slides else spec.joint_stiffness)

    return _evaluate_joints(legs, width, stiffness, spec.joint_stiffness)


def read_joint_dynamics(robot: UrdfRobot, legs: JointNames, width: int) -> JointDynamics:
    """Return rotor inertia, damping and friction of all joints.

    Rotor inertia is the section's of a joint, else of all that turn, else the `armature` of an MJCF
    file, else inferred from torque and speed limits. Derivative gains are the section's likewise,
    else damp rotors critically. Friction is that of the file's `<dynamics>`.

    Args:
        robot: The section and its URDF.
        legs: Names of the joints of N legs, from base to toe.
        width: J, joints of the longest leg.
    """
    spec, tree = robot.spec, robot.tree

    def build_reader(key: str, common: float | None) -> Callable[[str], float]:
        def value(joint: str) -> float:
            number = vars(spec.joints[joint])[key] if joint in spec.joints else None
            if number is None and not tree.joints[joint].slides:
                number = common
            if number is None and key == "rotor_inertia":
                number = tree.joints[joint].armature
            return np.nan if number is None else float(number)

        return value

    torque = read_joint_limits(robot, legs, width, "max_torque", "effort")
    speed = read_joint_limits(robot, legs, width, "max_speed", "velocity")
    inertia = _evaluate_joints(
        legs, width, build_reader("rotor_inertia", spec.joint_rotor_inertia), np.nan
    )
    inertia = np.where(np.isnan(inertia), default_rotor_inertia(torque, speed), inertia)
    motor = read_joint_stiffness(robot, legs, width) * (1 - spec.structural_compliance_share)
    damping = _evaluate_joints(legs, width, build_reader("damping", spec.joint_damping), np.nan)
    damping = np.where(np.isnan(damping), default_damping(motor, inertia), damping)
    viscous = _evaluate_joints(legs, width, lambda joint: tree.joints[joint].damping, 0.0)
    dry = _evaluate_joints(legs, width, lambda joint: tree.joints[joint].friction, 0.0)
    return JointDynamics(inertia, damping, viscous, dry)


def _evaluate_joints(
    legs: JointNames, width: int, value: Callable[[str], float], empty: float
) -> Array:
    """Return the value of each joint as (N, J)."""
    return pad_to_legs(width, [[value(joint) for joint in names] for names in legs], empty)
