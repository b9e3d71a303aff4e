"""A robot as a task uses it: its own nominal toes, and how hard its grippers may grip."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body


def with_stance(robot: Robot, stance: Mapping[str, tuple[float, float, float]]) -> Robot:
    """The robot with the task's own nominal toe positions."""
    nominal = robot.stance_body.copy()
    for name, toe in stance.items():
        nominal[robot.limb_names.index(name)] = toe
    return replace(robot, stance_body=nominal)


def with_grip_limit(robot: Robot, max_force: float | None) -> Robot:
    """The robot with the largest gripping force of the task [N], if it states one."""
    if robot.gripper is None or max_force is None:
        return robot
    return replace(robot, gripper=replace(robot.gripper, max_force=max_force))


def standing_as(robot: Robot, com: Array, rpy: Array, toes: Array, kept: Collection[str]) -> Robot:
    """The robot whose stance is how it stands: body at com (3,), rpy (3,), toes (N, 3), world.

    Limbs named in `kept` keep their nominal toes.
    """
    stance: Array = (toes - com) @ rotation_world_body(rpy)
    for name in kept:
        limb = robot.limb_names.index(name)
        stance[limb] = robot.stance_body[limb]
    return replace(robot, stance_body=stance)


def heading_as(robot: Robot, rpy: Array) -> Robot:
    """The robot whose flat feet point where a body of rotation rpy (3,) does."""
    if robot.foot is None or robot.foot.sole is None:
        return robot
    sole = replace(robot.foot.sole, heading=float(rpy[2]))
    return replace(robot, foot=replace(robot.foot, sole=sole))
