"""The motion of a walk: of the body and its toes, no joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.exports.motion import BodyMotion, ContactMotion, RobotMotion
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan_file import read_walk_plan


def walk_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError for a damaged one."""
    plan = read_walk_plan(path)
    found, body = plan.trajectory, plan.task.body
    rotation = Rotation.from_matrix(rotation_world_body(found.state[:, 6:9]))
    return RobotMotion(
        name=plan.name,
        robot=body.name,
        time=np.arange(plan.task.knots + 1, dtype=float) * float(plan.task.step),
        bodies=(BodyMotion("body", found.state[:, :3], rotation.as_quat()),),
        joints=None,
        contacts=ContactMotion(tuple(body.leg_names), found.toes, found.force, found.gait.contact),
        words=("a walk is planned as a body and its toes: joints are its controller's",),
    )
