"""The motion of a climb or transition plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.exports.motion import (
    BodyMotion,
    ContactMotion,
    JointMotion,
    LimbShape,
    RobotMotion,
    differentiated,
    gain_words,
)
from climbplan.mechanics.stiffness import joint_softness
from climbplan.plans.check import Array
from climbplan.reports.replay import sample_instants, true_angles
from climbplan.robots.kinematics import (
    contact_jacobian,
    contact_points,
    held_rows,
    joint_points_body,
    toe_world,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.terrain.surfaces import Region


def climb_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError where it is no climb or damaged."""
    plan = read_climb(path)
    moving, robot = plan.trajectory, plan.robot
    there = robot.has_joint
    angle = true_angles(plan, sample_instants(plan))
    # What bends a joint is the motor and the structure beyond it; encoders see the motor's part.
    torque = (moving.joint_command - angle) / joint_softness(robot)
    torque = np.where(moving.contact[..., None], torque, 0.0)
    seen = moving.joint_command - torque / robot.joint_stiffness
    names, slides = joint_names(robot), tuple(robot.slides[there].tolist())
    velocity, acceleration = differentiated(moving.time, moving.joint_command[:, there])
    quaternion = Rotation.from_matrix(rotation_world_body(moving.rpy)).as_quat(canonical=False)
    return RobotMotion(
        name=plan.name,
        robot=robot.name,
        time=moving.time,
        bodies=(BodyMotion("body", moving.com, _continuous(quaternion)),),
        joints=JointMotion(
            names=names,
            command=moving.joint_command[:, there],
            velocity=velocity,
            acceleration=acceleration,
            angle=seen[:, there],
            torque=torque[:, there],
            feedforward=np.zeros_like(torque[:, there]),
            gain=robot.joint_stiffness[there],
            slides=slides,
        ),
        contacts=_contacts(plan, angle, torque),
        limbs=_limbs(plan, angle),
        body_size=np.abs(robot.body_hull).max(axis=0),
        surfaces=tuple(s.material for s in plan.terrain.regions if isinstance(s, Region)),
        words=(gain_words(robot.joint_stiffness[there], slides=slides),),
    )


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Of all joints, limb by limb: those of the URDF, or limb and joint, "RF_femur"."""
    own = robot.limbs.joint_names
    if isinstance(robot.mechanism, SerialChain):  # those that mimic others have no motor
        return tuple(name for names in own for name in names if name)
    return tuple(
        f"{limb}_{name}"
        for limb, names in zip(robot.limb_names, own, strict=True)
        for name in names
        if name
    )


def _contacts(plan: ClimbPlan, angle: Array, torque: Array) -> ContactMotion:
    moving, robot = plan.trajectory, plan.robot
    force = moving.force
    normal = plan.instants.normal[np.maximum(sample_instants(plan), 0)]
    if force is None:  # tau = -J^T f, exact but near singular postures
        jacobian = contact_jacobian(robot, moving.rpy, angle, normal)
        jacobian = held_rows(
            robot, moving.rpy, angle, normal, jacobian
        )  # and moments, of flat feet
        inverse = np.linalg.pinv(np.swapaxes(jacobian, -1, -2), rcond=1e-6)
        force = -(inverse @ torque[..., None])[..., :3, 0]
    return ContactMotion(
        robot.limb_names,
        contact_points(robot, toe_world(robot, moving.com, moving.rpy, angle), normal),
        np.where(moving.contact[..., None], force, 0.0),
        moving.contact,
    )


def _limbs(plan: ClimbPlan, angle: Array) -> tuple[LimbShape, ...]:
    moving, robot = plan.trajectory, plan.robot
    rotation = rotation_world_body(moving.rpy)
    own = joint_points_body(robot, angle)  # (T, N, P, 3)
    points = moving.com[:, None, None] + np.einsum("tij,tnpj->tnpi", rotation, own)
    return tuple(
        LimbShape(name, points[:, n], robot.limb_radius) for n, name in enumerate(robot.limb_names)
    )


def _continuous(quaternion: Array) -> Array:
    """The same rotations, each on the side of the one before: readers may interpolate."""
    flips = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0
    sign = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2, -1.0, 1.0)])
    return np.asarray(quaternion * sign[:, None])
