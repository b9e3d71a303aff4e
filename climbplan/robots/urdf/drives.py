"""Motors of a robot from a URDF: limits, stiffness, rotor inertia, damping and friction."""

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

Names = Sequence[tuple[str, ...]]  # joints of each leg, from base to toe


def by_leg(width: int, rows: Sequence[Sequence[float]], empty: float) -> Array:
    """(N, J) of rows that may be shorter, whose first joints are then none."""
    return np.array([[empty] * (width - len(row)) + list(row) for row in rows])


def joint_limits(robot: UrdfRobot, legs: Names, width: int, key: str, attribute: str) -> Array:
    """(N, J) limits: the section's, else the URDF's."""
    own = robot.spec.joints

    def limit(joint: str) -> float:
        if robot.tree.joints[joint].mimic is not None:  # its motor is that of another joint
            return 1.0
        given = vars(own[joint])[key] if joint in own else None
        return float(given or vars(robot.tree.joints[joint])[attribute])

    return _arranged(legs, width, limit, 1.0)


def joint_stiffness_of(robot: UrdfRobot, legs: Names, width: int) -> Array:
    """(N, J) stiffness under position control: a joint's own, else the robot's [N m/rad]."""
    own, spec = robot.spec.joints, robot.spec

    def stiffness(joint: str) -> float:
        given = own[joint].stiffness if joint in own else None
        slides = robot.tree.joints[joint].slides
        return given or (spec.slide_stiffness if slides else spec.joint_stiffness)

    return _arranged(legs, width, stiffness, spec.joint_stiffness)


def joint_dynamics_of(robot: UrdfRobot, legs: Names, width: int) -> JointDynamics:
    """Rotor inertia, damping and friction of all joints.

    Rotor inertia is the section's of a joint, else of all that turn, else the `armature` of an MJCF
    file, else by torque and speed limits. Derivative gains are the section's likewise, else damp
    rotors critically. Friction is what the file has in `<dynamics>`.

    Args:
        robot: the section and its URDF.
        legs: names of the joints of N legs, from base to toe.
        width: J, joints of the longest leg; others have none at their beginning.
    """
    spec, tree = robot.spec, robot.tree

    def stated(key: str, common: float | None) -> Callable[[str], float]:
        def value(joint: str) -> float:
            own = vars(spec.joints[joint])[key] if joint in spec.joints else None
            if own is None and not tree.joints[joint].slides:
                own = common
            if own is None and key == "rotor_inertia":
                own = tree.joints[joint].armature
            return np.nan if own is None else float(own)

        return value

    torque = joint_limits(robot, legs, width, "max_torque", "effort")
    speed = joint_limits(robot, legs, width, "max_speed", "velocity")
    inertia = _arranged(legs, width, stated("rotor_inertia", spec.joint_rotor_inertia), np.nan)
    inertia = np.where(np.isnan(inertia), default_rotor_inertia(torque, speed), inertia)
    motor = joint_stiffness_of(robot, legs, width) * (1 - spec.structural_compliance_share)
    damping = _arranged(legs, width, stated("damping", spec.joint_damping), np.nan)
    damping = np.where(np.isnan(damping), default_damping(motor, inertia), damping)
    viscous = _arranged(legs, width, lambda joint: tree.joints[joint].damping, 0.0)
    dry = _arranged(legs, width, lambda joint: tree.joints[joint].friction, 0.0)
    return JointDynamics(inertia, damping, viscous, dry)


def _arranged(legs: Names, width: int, value: Callable[[str], float], empty: float) -> Array:
    """(N, J) of what each joint has."""
    return by_leg(width, [[value(joint) for joint in names] for names in legs], empty)
