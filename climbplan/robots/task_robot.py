"""A robot as a task uses it: with the task's nominal toes, and its limit on gripping forces."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body


def with_stance(robot: Robot, stance: Mapping[str, tuple[float, float, float]]) -> Robot:
    """Return the robot with the task's nominal toe positions."""
    nominal = robot.stance_body.copy()
    for name, toe in stance.items():
        nominal[robot.limb_names.index(name)] = toe
    return replace(robot, stance_body=nominal)


def with_grip_limit(robot: Robot, max_force: float | None) -> Robot:
    """Return the robot with the largest gripping force of the task [N], if it states one."""
    if robot.gripper is None or max_force is None:
        return robot
    return replace(robot, gripper=replace(robot.gripper, max_force=max_force))


def standing_as(
    robot: Robot, com: Array, rpy: Array, toes: Array, nominal_limbs: Collection[str]
) -> Robot:
    """Return the robot whose stance is how it stands.

    Args:
        robot: The robot.
        com: Position of the body (3,), world frame [m].
        rpy: Rotation of the body (3,) [rad].
        toes: Positions (N, 3), world frame [m].
        nominal_limbs: Names of limbs that keep their nominal toes.
    """
    stance: Array = (toes - com) @ rotation_world_body(rpy)
    for name in nominal_limbs:
        limb = robot.limb_names.index(name)
        stance[limb] = robot.stance_body[limb]
    return replace(robot, stance_body=stance)


def heading_as(robot: Robot, rpy: Array) -> Robot:
    """Return the robot whose flat feet point where a body of rotation rpy (3,) does."""
    if robot.foot is None or robot.foot.sole is None:
        return robot
    sole = replace(robot.foot.sole, heading=float(rpy[2]))
    return replace(robot, foot=replace(robot.foot, sole=sole))
