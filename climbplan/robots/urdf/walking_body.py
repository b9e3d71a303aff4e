"""A legged robot from a URDF as walking has it: one rigid body, and legs with joints and motors.

Body frame x forward, y to the left, z up, origin in the centre of mass of the whole robot in its
standing posture, about which its inertia is: masses of legs count as if they were fixed there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.building import chain_at_zero, joint_angles_of
from climbplan.robots.urdf.drives import by_leg, joint_limits
from climbplan.robots.urdf.pinocchio_model import UrdfModel, urdf_model
from climbplan.robots.urdf.toe_boxes import ToeBoxes, toe_boxes
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.document import Finding
from climbplan.schema.robots.leg_pairs import LEG_COUNTS, in_pairs
from climbplan.schema.robots.urdf.robot import UrdfRobot

TO_WALKING = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From climbing's axes (x right, y forward) to walking's (x forward, y left)."""
_LEAST, _MOST = 3, 7  # joints of a leg


@dataclass(frozen=True)
class WalkingBody:
    """What walking needs to know of a robot."""

    name: str
    leg_names: tuple[str, ...]
    mass: float  # [kg]
    inertia: Array  # (3, 3) about the centre of mass [kg m^2]
    gravity: float  # [m/s^2]
    height: float  # [m] of the centre of mass above the standing toes
    boxes: ToeBoxes
    legs: WalkingLegs
    foot: float  # [m] radius of its feet, 0 of points


def walking_body(robot: UrdfRobot) -> WalkingBody:
    """The body and legs of a robot section.

    Raises MissingSolver without Pinocchio, and SpecError, at the lines of the section, for a robot
    that has no pairs of legs, or has no room or no strength to walk.
    """
    if robot.spec.flat_feet:
        message = "walks stand on points: expected `radius`, or no `foot`"
        raise robot.refused([Finding(("foot",), message)])
    names = _leg_names(robot)
    joints = max(len(own) for own in robot.joints.values())
    found = urdf_model(robot)
    mass = robot.spec.mass or found.mass()
    if not mass > 0:
        raise robot.refused([Finding(("urdf",), f"expected a mass > 0, got {mass:g} kg")])
    if not robot.spec.gravity > 0:
        raise robot.refused([Finding(("gravity",), "expected more than 0 to walk")])
    at_zero = [found.leg(name) for name in names]
    lower, upper, posture = (
        by_leg(joints, [[values[j] for j in leg.names] for leg in at_zero], empty)
        for values, empty in zip(joint_angles_of(robot), (-1.0, 1.0, 0.0), strict=True)
    )
    standing = {
        joint: float(angle)
        for leg, row in zip(at_zero, posture, strict=True)
        for joint, angle in zip(leg.names, row[joints - len(leg.names) :], strict=True)
    }
    chain = chain_at_zero(at_zero, joints, found.center(standing), posture)
    chain = chain.turned(TO_WALKING)
    toes = chain.joint_points(posture)[:, -1]
    order = in_pairs(toes.tolist())
    if order is None:
        message = "expected pairs of toes, one on either side, one pair behind the other"
        raise robot.refused([Finding(("legs",), message)])
    chain = chain.ordered(order)
    toes, names = toes[order], tuple(names[i] for i in order)
    ordered = [at_zero[i].names for i in order]
    legs = WalkingLegs(
        chain,
        lower[order],
        upper[order],
        joint_limits(robot, ordered, joints, "max_torque", "effort"),
        joint_limits(robot, ordered, joints, "max_speed", "velocity"),
    )
    boxes = toe_boxes(
        chain, toes, legs.lower, legs.upper, legs.max_torque, mass * robot.spec.gravity
    )
    if isinstance(boxes, str):
        raise robot.refused([Finding(("legs",), boxes)])
    return WalkingBody(
        name=robot.name,
        leg_names=names,
        mass=mass,
        inertia=mass / found.mass() * inertia_of(found, standing),
        gravity=robot.spec.gravity,
        height=float(-toes[:, 2].mean()),
        boxes=boxes,
        legs=legs,
        foot=robot.spec.foot_radius,
    )


def _leg_names(robot: UrdfRobot) -> tuple[str, ...]:
    """Legs as the section names them; raises SpecError for an odd one."""
    names = robot.limb_names
    faults = []
    if len(names) not in LEG_COUNTS:
        message = f"walking is of four, six or eight legs, got {len(names)}"
        faults.append(Finding(("legs",), message))
    faults += [
        Finding(
            ("legs", name),
            f"walking is of legs with {_LEAST} to {_MOST} joints, got {len(own)}: "
            + ", ".join(joint.name for joint in own),
        )
        for name, own in robot.own_joints.items()
        if not _LEAST <= len(own) <= _MOST
    ]
    faults += [
        Finding(("legs", name, "stance"), "walking stands as `posture_deg` has it")
        for name in names
        if robot.spec.legs[name].stance is not None
    ]
    if faults:
        raise robot.refused(faults)
    return names


def inertia_of(found: UrdfModel, standing: dict[str, float]) -> Array:
    """(3, 3) of the whole robot about its centre of mass, axes of walking [kg m^2]."""
    pin, model = found.library, found.model
    data = model.createData()
    pin.ccrba(model, data, found.angles(standing), np.zeros(model.nv))
    turn = TO_WALKING @ found.turn
    inertia: Array = turn @ np.array(data.Ig.inertia) @ turn.T
    return 0.5 * (inertia + inertia.T)
