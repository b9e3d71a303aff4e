"""A legged robot from a URDF for walking: one rigid body, and legs with joints and motors.

Body frame x forward, y to the left, z up, origin in the centre of mass of the whole robot in its
standing posture, about which its inertia is: masses of legs count as if they were fixed there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.drives import read_joint_limits
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.robot_builder import build_chain_at_zero, read_leg_angles, read_mass
from climbplan.robots.urdf.toe_boxes import ToeBoxes, grow_toe_boxes
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.document import Finding
from climbplan.schema.robots.leg_pairs import LEG_COUNTS, order_in_pairs
from climbplan.schema.robots.urdf.robot import UrdfRobot

TO_WALKING = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From climbing's axes (x right, y forward) to walking's (x forward, y left)."""
_MIN_JOINTS, _MAX_JOINTS = 3, 7  # of a leg


@dataclass(frozen=True)
class WalkingBody:
    """The body and the legs that walking plans with."""

    name: str
    leg_names: tuple[str, ...]
    mass: float  # [kg]
    inertia: Array  # (3, 3) about the centre of mass [kg m^2]
    gravity: float  # [m/s^2]
    height: float  # [m] of the centre of mass above the standing toes
    boxes: ToeBoxes
    legs: WalkingLegs
    foot: float  # [m] radius of its feet, 0 of points


def build_walking_body(robot: UrdfRobot) -> WalkingBody:
    """Build the body and legs of a robot section.

    Raises:
        MissingSolver: Pinocchio is not installed.
        SpecError: The robot has no pairs of legs, or is too weak or too cramped to walk; at the
            lines of the section.
    """
    if robot.spec.flat_feet:
        message = "walks stand on points: expected `radius`, or no `foot`"
        raise robot.build_error([Finding(("foot",), message)])
    names = _read_leg_names(robot)
    joints = max(len(leg_joints) for leg_joints in robot.joints.values())
    urdf_model = build_urdf_model(robot)
    mass = read_mass(urdf_model)
    if not robot.spec.gravity > 0:
        raise robot.build_error([Finding(("gravity",), "expected more than 0 to walk")])
    at_zero = [urdf_model.read_leg(name) for name in names]
    lower, upper, posture = read_leg_angles(robot, at_zero, joints)
    standing = {
        joint: float(angle)
        for leg, row in zip(at_zero, posture, strict=True)
        for joint, angle in zip(leg.names, row[joints - len(leg.names) :], strict=True)
    }
    chain = build_chain_at_zero(at_zero, joints, urdf_model.compute_center(standing), posture)
    chain = chain.rotate(TO_WALKING)
    toes = chain.joint_points(posture)[:, -1]
    order = order_in_pairs(toes.tolist())
    if order is None:
        message = "expected pairs of toes, one on either side, one pair behind the other"
        raise robot.build_error([Finding(("legs",), message)])
    chain = chain.select_limbs(order)
    toes, names = toes[order], tuple(names[i] for i in order)
    ordered = [at_zero[i].names for i in order]
    legs = WalkingLegs(
        chain,
        lower[order],
        upper[order],
        read_joint_limits(robot, ordered, joints, "max_torque", "effort"),
        read_joint_limits(robot, ordered, joints, "max_speed", "velocity"),
    )
    boxes = grow_toe_boxes(
        chain, toes, legs.lower, legs.upper, legs.max_torque, mass * robot.spec.gravity
    )
    if isinstance(boxes, str):
        raise robot.build_error([Finding(("legs",), boxes)])
    return WalkingBody(
        name=robot.name,
        leg_names=names,
        mass=mass,
        inertia=mass / urdf_model.compute_mass() * compute_inertia(urdf_model, standing),
        gravity=robot.spec.gravity,
        height=float(-toes[:, 2].mean()),
        boxes=boxes,
        legs=legs,
        foot=robot.spec.foot_radius,
    )


def _read_leg_names(robot: UrdfRobot) -> tuple[str, ...]:
    """Return the legs as the section names them; raises SpecError for unsupported ones."""
    names = robot.limb_names
    findings = []
    if len(names) not in LEG_COUNTS:
        message = f"walking is of four, six or eight legs, got {len(names)}"
        findings.append(Finding(("legs",), message))
    findings += [
        Finding(
            ("legs", name),
            f"walking is of legs with {_MIN_JOINTS} to {_MAX_JOINTS} joints, got {len(joints)}: "
            + ", ".join(joint.name for joint in joints),
        )
        for name, joints in robot.own_joints.items()
        if not _MIN_JOINTS <= len(joints) <= _MAX_JOINTS
    ]
    findings += [
        Finding(("legs", name, "stance"), "walking stands as `posture_deg` has it")
        for name in names
        if robot.spec.legs[name].stance is not None
    ]
    if findings:
        raise robot.build_error(findings)
    return names


def compute_inertia(urdf_model: UrdfModel, standing: dict[str, float]) -> Array:
    """Return the inertia (3, 3) about the centre of mass, axes of walking [kg m^2].

    Args:
        urdf_model: The robot.
        standing: Joint angles by name [rad].
    """
    pin, model = urdf_model.library, urdf_model.model
    data = model.createData()
    pin.ccrba(model, data, urdf_model.build_configuration(standing), np.zeros(model.nv))
    rotation = TO_WALKING @ urdf_model.root_to_base_rotation
    inertia: Array = rotation @ np.array(data.Ig.inertia) @ rotation.T
    return 0.5 * (inertia + inertia.T)
