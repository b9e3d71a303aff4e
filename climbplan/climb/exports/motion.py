"""The motion of a climb or transition plan, for controllers and other simulators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.errors import ClimbplanError
from climbplan.exports.base_link import BaseLink, build_base_link, collect_urdf_facts
from climbplan.exports.damping import critical_damping
from climbplan.exports.motion import (
    BodyMotion,
    ContactMotion,
    ExportedJoints,
    JointLimits,
    LimbLinks,
    RobotMotion,
    describe_gains,
    differentiate_spline,
    unwrap_quaternions,
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
from climbplan.schema.robots.stored import NotKept, build_stored_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.motors import compute_motor_damping, compute_motor_stiffness
from climbplan.terrain.surfaces import Region


def compute_min_joint_inertia(robot: Robot, angles: Array) -> Array:
    """Return the smallest inertia (N, J) of limbs in the air about their joints [kg m^2, kg].

    The inertia is that of the links from a joint outward, at angles (T, N, J). Where limbs are
    massless it is the assumed inertia of the motors (rotors).
    """
    chain, links = robot.mechanism, robot.links
    if links is None or not isinstance(chain, SerialChain):
        damping, stiffness = (
            compute_motor_damping(robot, NOMINAL),
            compute_motor_stiffness(robot, NOMINAL),
        )
        return np.asarray(damping**2 / (4 * stiffness))
    pose = chain.pose(angles)
    lever_arms = links.middles(chain, angles)[..., None, :, :] - pose.joints[..., :, None, :]
    is_carried = np.triu(np.ones((robot.joint_count, robot.joint_count)))[
        ..., None
    ]  # (joint, link)
    link_velocity = np.cross(pose.axes[..., :, None, :], lever_arms)  # (T, N, joint, link, 3)
    if pose.slides is not None:
        link_velocity = link_velocity + pose.slides[..., :, None, :]
    angular_velocity = np.broadcast_to(pose.axes[..., :, None, :], link_velocity.shape)
    link_velocity, angular_velocity = link_velocity * is_carried, angular_velocity * is_carried
    if pose.drive is not None:  # joints that mimic others move with them
        link_velocity, angular_velocity = (
            np.einsum("nji,tnjlk->tnilk", pose.drive, component)
            for component in (link_velocity, angular_velocity)
        )
    inertia = pose.turns @ links.inertia @ np.swapaxes(pose.turns, -1, -2)  # (T, N, link, 3, 3)
    energy = links.mass[:, None, :] * (link_velocity**2).sum(axis=-1)
    energy += np.einsum("tnjli,tnlik,tnjlk->tnjl", angular_velocity, inertia, angular_velocity)
    return np.asarray(energy.sum(axis=-1).min(axis=0))


def read_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError where it is no climb or damaged."""
    return build_motion(read_climb(path))


def build_motion(plan: ClimbPlan) -> RobotMotion:
    """Return the data of a plan's motion that controllers and other simulators need."""
    trajectory, robot = plan.trajectory, plan.robot
    has_joint = robot.has_joint
    angle = compute_true_angles(plan, sample_instants(plan))
    # What bends a joint is the motor and the structure beyond it; encoders see the motor's part.
    torque = (trajectory.joint_command - angle) / joint_softness(robot)
    torque = np.where(trajectory.contact[..., None], torque, 0.0)
    link_load = link_torques(robot, trajectory.rpy, angle)
    if trajectory.torque is not None:  # with the links' inertia
        link_load = trajectory.torque + torque
    encoder_angle = trajectory.joint_command - torque / robot.joint_stiffness
    slides = tuple(robot.slides[has_joint].tolist())
    velocity, acceleration = differentiate_spline(
        trajectory.time, trajectory.joint_command[:, has_joint]
    )
    rotation = rotation_world_body(trajectory.rpy)
    quaternion = Rotation.from_matrix(rotation).as_quat(canonical=False)
    root_link, facts, notes = _read_root_link(plan)
    return RobotMotion(
        name=plan.name,
        robot=robot.name,
        time=trajectory.time,
        bodies=(BodyMotion("body", trajectory.com, unwrap_quaternions(quaternion)),),
        base=None if root_link is None else root_link.motion(trajectory.com, rotation),
        joints=ExportedJoints(
            names=robot.motor_names,
            command=trajectory.joint_command[:, has_joint],
            velocity=velocity,
            acceleration=acceleration,
            angle=encoder_angle[:, has_joint],
            torque=torque[:, has_joint],
            feedforward=np.zeros_like(torque[:, has_joint]),
            gravity=-link_load[:, has_joint],
            gain=robot.joint_stiffness[has_joint],
            slides=slides,
            limits=_build_joint_limits(plan, angle),
            link_angle=trajectory.joint_command[:, has_joint]
            - (torque * joint_softness(robot))[:, has_joint],
        ),
        contacts=_build_contacts(plan, angle, torque),
        limbs=_build_limb_shapes(plan, angle),
        body_size=np.abs(robot.body_hull).max(axis=0),
        surfaces=tuple(s.material for s in plan.terrain.regions if isinstance(s, Region)),
        words=(describe_gains(robot.joint_stiffness[has_joint], slides=slides), *notes),
        facts={
            "structural_compliance_share": robot.structural_compliance_share,
            "foot_radius": 0.0 if robot.foot is None else robot.foot.radius,
            "surfaces": _list_surfaces(plan),
            **facts,
        },
    )


def _build_joint_limits(plan: ClimbPlan, angle: Array) -> JointLimits:
    """Return gains, damping and torque limits of the joints."""
    robot = plan.robot
    has_joint, shape = robot.has_joint, robot.has_joint.shape
    names = np.broadcast_to(np.array(robot.limb_names)[:, None], shape)
    damping = critical_damping(compute_min_joint_inertia(robot, angle), robot.joint_stiffness)
    return JointLimits(
        limb=tuple(names[has_joint].tolist()),
        rigid_gain=robot.joint_stiffness[has_joint] * (1 - robot.structural_compliance_share),
        damping=damping[has_joint],
        max_torque=robot.max_torque[has_joint],
    )


def read_plan_urdf(plan: ClimbPlan) -> UrdfRobot | None:
    """Return the URDF robot that a plan carries; None if it carries none.

    Raises:
        NotKept: The plan does not carry what its spec names.
        ClimbplanError: The text is no robot.
    """
    if not plan.robot_texts.urdf or not isinstance(plan.robot.mechanism, SerialChain):
        return None
    robot = build_stored_robot(parse_yaml(plan.spec_text, "spec"), plan.robot_texts).robot
    return robot if isinstance(robot, UrdfRobot) else None


def _read_root_link(plan: ClimbPlan) -> tuple[BaseLink | None, dict[str, object], tuple[str, ...]]:
    """Return root link and facts of the URDF that a plan carries, and notes where they are
    unreadable.
    """
    chain = plan.robot.mechanism
    try:
        robot = read_plan_urdf(plan)
        if robot is None or not isinstance(chain, SerialChain):
            return None, {}, ()
        facts = dict(collect_urdf_facts(robot))
        return build_base_link(robot, chain, np.eye(3)), facts, ()
    except (NotKept, ClimbplanError, ValueError) as reason:
        cause = str(reason).splitlines()[0]
        return None, {}, (f"the pose of the URDF's root link is not exported: {cause}",)


def _list_surfaces(plan: ClimbPlan) -> list[dict[str, object]]:
    """Return the flat surfaces of the terrain at the position of their material."""
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


def _build_contacts(plan: ClimbPlan, angle: Array, torque: Array) -> ContactMotion:
    """Return contact points and forces of all limbs."""
    trajectory, robot = plan.trajectory, plan.robot
    normal = plan.instants.normal[np.maximum(sample_instants(plan), 0)]
    force = trajectory.force
    if force is None:
        force = solve_contact_wrench(plan, angle, torque)[..., :3]
    return ContactMotion(
        robot.limb_names,
        contact_points(robot, toe_world(robot, trajectory.com, trajectory.rpy, angle), normal),
        np.where(trajectory.contact[..., None], force, 0.0),
        trajectory.contact,
    )


def solve_contact_wrench(plan: ClimbPlan, angle: Array, torque: Array) -> Array:
    """Return contact forces (T, N, 3), of flat feet forces and moments about toes (T, N, 6).

    They solve tau = -J^T f, which is exact but near singular postures.

    Args:
        plan: The plan, T samples and N limbs.
        angle: (T, N, J) [rad].
        torque: (T, N, J) of motors against contact forces [N m].
    """
    robot, rpy = plan.robot, plan.trajectory.rpy
    normal = plan.instants.normal[np.maximum(sample_instants(plan), 0)]
    jacobian = contact_jacobian(robot, rpy, angle, normal)
    rows = held_rows(robot, rpy, angle, normal, jacobian)
    inverse = np.linalg.pinv(np.swapaxes(rows, -1, -2), rcond=1e-6)
    return np.asarray(-(inverse @ torque[..., None])[..., 0])


def _build_limb_shapes(plan: ClimbPlan, angle: Array) -> tuple[LimbLinks, ...]:
    """Return the limbs as polylines with a radius."""
    trajectory, robot = plan.trajectory, plan.robot
    rotation = rotation_world_body(trajectory.rpy)
    points_body = joint_points_body(robot, angle)  # (T, N, P, 3)
    points = trajectory.com[:, None, None] + np.einsum("tij,tnpj->tnpi", rotation, points_body)
    return tuple(
        LimbLinks(name, points[:, n], robot.limb_radius) for n, name in enumerate(robot.limb_names)
    )
