"""A robot as the second method has it: from the robot file with which it was planned.

The file is what `climbplan new robot` writes, so that toes, locked joints and motors are those of
the plans, and no posture is proposed a second time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.zoo.second.stances import Limbs
from climbplan.robots.urdf.drives import read_joint_limits
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.self_collision import (
    SelfCollisionModel,
    build_self_collision_model,
)
from climbplan.robots.urdf.robot_builder import read_joint_angles
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

_ALIKE = 0.2  # of their length, by which limbs of one kind may differ
_ON_ONE_LEVEL = 0.02  # [m] by which toes that stand on the ground differ in height


@dataclass(frozen=True)
class Subject:
    """One robot, looked at for all of its columns."""

    limbs: Limbs
    parts: SelfCollisionModel | None  # that must not touch; None without collision geometry
    standing: dict[str, float]  # [rad] by joint: as it was planned to stand on the ground
    on_walls: tuple[bool, ...]  # limbs whose toes are on walls while it stands so

    @property
    def attitudes(self) -> int:
        """In how many ways a body may lie: front or back down too, where limbs are not alike."""
        length = self.limbs.lengths
        counts = {len(own) for own in self.limbs.joints}
        alike = len(counts) == 1 and float(np.ptp(length)) <= _ALIKE * float(length.max())
        return 1 if alike else 3


def subject_of(path: Path) -> Subject:
    """The robot of a robot file; raises SpecError for what is wrong in it."""
    robot = load_any_robot(path)
    if not isinstance(robot, UrdfRobot):
        raise TypeError(f"{path}: no robot from a URDF")
    return subject_of_robot(robot)


def subject_of_robot(robot: UrdfRobot) -> Subject:
    """As `subject_of`, of a robot that was read."""
    model = build_urdf_model(robot)
    lower, upper, standing = read_joint_angles(robot)
    legs = [model.read_leg(name) for name in robot.limb_names]
    width = max(len(leg.names) for leg in legs)
    torque = read_joint_limits(robot, [leg.names for leg in legs], width, "max_torque", "effort")
    limits = {
        joint: float(limit)
        for leg, row in zip(legs, torque, strict=True)
        for joint, limit in zip(leg.names, row[width - len(leg.names) :], strict=True)
    }
    limbs = Limbs(model, limits)
    bounds = {name: (max(lower[name], -np.pi), min(upper[name], np.pi)) for name in limits}
    parts = build_self_collision_model(model, bounds) if robot.needs_shapes else None
    limbs.placed(model.root_to_base_rotation, standing)
    height = np.array([limbs.toe(limb)[0][2] for limb in range(len(limbs.names))])
    raised = height > height.min() + _ON_ONE_LEVEL
    return Subject(limbs, parts, standing, tuple(bool(one) for one in raised))
