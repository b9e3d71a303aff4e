"""The motion of a climb or transition plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.errors import ClimbplanError
from climbplan.exports.base_link import BaseLink, base_link, urdf_facts
from climbplan.exports.damping import critical_damping
from climbplan.exports.motion import (
    BodyMotion,
    ContactMotion,
    JointLimits,
    JointMotion,
    LimbShape,
    RobotMotion,
    continuous_quaternions,
    differentiated,
    gain_words,
)
from climbplan.mechanics.equilibrium import link_torques
from climbplan.mechanics.stiffness import joint_softness
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
from climbplan.schema.robots.stored import NotKept, stored_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.motors import motor_damping, motor_stiffness
from climbplan.terrain.surfaces import Region


def joint_inertia(robot: Robot, angles: Array) -> Array:
    """Return the least inertia (N, J) of limbs in the air about their joints [kg m^2, kg].

    Links from a joint outward, at angles (T, N, J); what motors are assumed to turn with (rotors)
    where limbs weigh nothing.
    """
    chain, links = robot.mechanism, robot.links
    if links is None or not isinstance(chain, SerialChain):
        damping, stiffness = motor_damping(robot, NOMINAL), motor_stiffness(robot, NOMINAL)
        return np.asarray(damping**2 / (4 * stiffness))
    pose = chain.pose(angles)
    arms = links.middles(chain, angles)[..., None, :, :] - pose.joints[..., :, None, :]
    outward = np.triu(np.ones((robot.joint_count, robot.joint_count)))[..., None]  # (joint, link)
    moving = np.cross(pose.axes[..., :, None, :], arms)  # (T, N, joint, link, 3)
    if pose.slides is not None:
        moving = moving + pose.slides[..., :, None, :]
    turning = np.broadcast_to(pose.axes[..., :, None, :], moving.shape)
    moving, turning = moving * outward, turning * outward
    if pose.drive is not None:  # joints that mimic others move with them
        moving, turning = (
            np.einsum("nji,tnjlk->tnilk", pose.drive, part) for part in (moving, turning)
        )
    inertia = pose.turns @ links.inertia @ np.swapaxes(pose.turns, -1, -2)  # (T, N, link, 3, 3)
    energy = links.mass[:, None, :] * (moving**2).sum(axis=-1)
    energy += np.einsum("tnjli,tnlik,tnjlk->tnjl", turning, inertia, turning)
    return np.asarray(energy.sum(axis=-1).min(axis=0))


def read_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError where it is no climb or damaged."""
    return motion_of_climb(read_climb(path))


def motion_of_climb(plan: ClimbPlan) -> RobotMotion:
    """Return what controllers and other simulators have to know of a plan's motion."""
    moving, robot = plan.trajectory, plan.robot
    there = robot.has_joint
    angle = true_angles(plan, sample_instants(plan))
    # What bends a joint is the motor and the structure beyond it; encoders see the motor's part.
    torque = (moving.joint_command - angle) / joint_softness(robot)
    torque = np.where(moving.contact[..., None], torque, 0.0)
    seen = moving.joint_command - torque / robot.joint_stiffness
    slides = tuple(robot.slides[there].tolist())
    velocity, acceleration = differentiated(moving.time, moving.joint_command[:, there])
    rotation = rotation_world_body(moving.rpy)
    quaternion = Rotation.from_matrix(rotation).as_quat(canonical=False)
    link, facts, words = _of_urdf(plan)
    return RobotMotion(
        name=plan.name,
        robot=robot.name,
        time=moving.time,
        bodies=(BodyMotion("body", moving.com, continuous_quaternions(quaternion)),),
        base=None if link is None else link.motion(moving.com, rotation),
        joints=JointMotion(
            names=robot.motor_names,
            command=moving.joint_command[:, there],
            velocity=velocity,
            acceleration=acceleration,
            angle=seen[:, there],
            torque=torque[:, there],
            feedforward=np.zeros_like(torque[:, there]),
            gravity=-link_torques(robot, moving.rpy, angle)[:, there],
            gain=robot.joint_stiffness[there],
            slides=slides,
            limits=_limits(plan, angle),
            link_angle=moving.joint_command[:, there] - (torque * joint_softness(robot))[:, there],
        ),
        contacts=_contacts(plan, angle, torque),
        limbs=_limbs(plan, angle),
        body_size=np.abs(robot.body_hull).max(axis=0),
        surfaces=tuple(s.material for s in plan.terrain.regions if isinstance(s, Region)),
        words=(gain_words(robot.joint_stiffness[there], slides=slides), *words),
        facts={
            "structural_compliance_share": robot.structural_compliance_share,
            "foot_radius": 0.0 if robot.foot is None else robot.foot.radius,
            "surfaces": _surfaces(plan),
            **facts,
        },
    )


def _limits(plan: ClimbPlan, angle: Array) -> JointLimits:
    robot = plan.robot
    there, shape = robot.has_joint, robot.has_joint.shape
    names = np.broadcast_to(np.array(robot.limb_names)[:, None], shape)
    damping = critical_damping(joint_inertia(robot, angle), robot.joint_stiffness)
    return JointLimits(
        limb=tuple(names[there].tolist()),
        rigid_gain=robot.joint_stiffness[there] * (1 - robot.structural_compliance_share),
        damping=damping[there],
        max_torque=robot.max_torque[there],
    )


def _of_urdf(plan: ClimbPlan) -> tuple[BaseLink | None, dict[str, object], tuple[str, ...]]:
    """Root link and facts of the URDF that a plan carries, and words where they cannot be read."""
    chain = plan.robot.mechanism
    if not plan.robot_texts.urdf or not isinstance(chain, SerialChain):
        return None, {}, ()
    try:
        robot = stored_robot(parse_yaml(plan.spec_text, "spec"), plan.robot_texts).robot
        if not isinstance(robot, UrdfRobot):
            return None, {}, ()
        facts = dict(urdf_facts(robot))
        return base_link(robot, chain, np.eye(3)), facts, ()
    except (NotKept, ClimbplanError, ValueError) as reason:
        why = str(reason).splitlines()[0]
        return None, {}, (f"the pose of the URDF's root link is not exported: {why}",)


def _surfaces(plan: ClimbPlan) -> list[dict[str, object]]:
    """Flat surfaces of the terrain, where their material is."""
    return [
        {
            "name": region.name,
            "kind": "flat",
            "corners": region.material.tolist(),
            "normal": region.normal.tolist(),
            "friction": region.friction,
        }
        for region in plan.terrain.regions
    ]


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
