"""The motion of a module plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.exports.motion import BodyMotion, JointMotion, LimbShape, RobotMotion
from climbplan.limms.plan_file import read_limms_plan

_JOINTS = 6
_RADIUS = 0.02  # [m] of links in pictures


def limms_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError for a damaged one.

    Boxes stay upright; the first end of each module is a body. Torques are unknown: modules
    have no mass in the plan.
    """
    plan = read_limms_plan(path)
    motion = plan.motion
    # Where modes change a time is there twice: what comes after it counts
    last = np.append(np.diff(motion.time) > 1e-9, True)
    time = motion.time[last]
    angle = motion.joint_angles[last].reshape(len(time), -1)
    velocity = motion.joint_velocity[last].reshape(angle.shape)
    boxes = motion.box_position.shape[1]
    bodies = [
        BodyMotion(
            "box" if boxes == 1 else f"box{b}",
            motion.box_position[last, b],
            Rotation.from_rotvec(np.outer(motion.box_yaw[last, b], [0.0, 0.0, 1.0])).as_quat(),
        )
        for b in range(boxes)
    ]
    for m, name in enumerate(plan.module_names):
        rotation = Rotation.from_matrix(motion.joint_rotation[last, m, 0])
        bodies.append(BodyMotion(name, motion.joint_position[last, m, 0], rotation.as_quat()))
    names = tuple(f"{name}_joint{j}" for name in plan.module_names for j in range(1, _JOINTS + 1))
    nothing = np.zeros_like(angle)
    return RobotMotion(
        name=plan.name,
        robot=", ".join(plan.module_names),
        time=time,
        bodies=tuple(bodies),
        joints=JointMotion(
            names=names,
            command=angle,
            velocity=velocity,
            acceleration=np.gradient(velocity, time, axis=0) if len(time) > 2 else nothing,
            angle=angle,
            torque=nothing,
            feedforward=nothing,
            gain=np.zeros(len(names)),
        ),
        contacts=None,
        limbs=tuple(
            LimbShape(name, motion.joint_position[last, m], _RADIUS)
            for m, name in enumerate(plan.module_names)
        ),
        body_size=plan.box_size[0] / 2,
        words=("modules have no mass in the plan: no torques, commands are the angles themselves",),
    )
