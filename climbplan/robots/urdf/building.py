"""From a checked robot section and its URDF to the arrays that planning computes with.

The body frame has x to the right, y forward and z up, and its origin in the centre of mass of the
whole robot in its posture.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import Foot
from climbplan.robots.gripper import Gripper
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.touching_parts import always_touching
from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS, leg_capsules
from climbplan.robots.urdf.drives import by_leg, joint_dynamics_of, joint_limits, joint_stiffness_of
from climbplan.robots.urdf.flat_feet import sole_capsules, sole_of, with_soles
from climbplan.robots.urdf.link_masses import link_masses_of
from climbplan.robots.urdf.pinocchio_model import LegAtZero, urdf_model
from climbplan.robots.urdf.shapes import body_box, body_parts, collision_shapes
from climbplan.robots.urdf.toe_surface import buried_toes
from climbplan.robots.urdf.workspace import common_reach, farthest_toes, stance_balls
from climbplan.schema.document import Finding
from climbplan.schema.robots.ranges import LENGTH, THICKNESS
from climbplan.schema.robots.urdf.checks import led_bounds
from climbplan.schema.robots.urdf.robot import UrdfRobot

_THINNEST = 0.02  # [m] half extent of a body at least
LEAST_BALL = 0.025  # [m] about the stance, below which no step could be planned
_ON_MIDDLE = 1e-3  # [m] off the middle plane within which a toe is on neither side


def robot_of_urdf(robot: UrdfRobot) -> Robot:
    """The arrays of a robot from a URDF.

    Raises MissingSolver without Pinocchio, and SpecError, at the lines of the section, for what
    only numbers tell: no mass, a mesh that cannot be read, a stance out of reach.
    """
    spec = robot.spec
    found = urdf_model(robot)
    mass = spec.mass or found.mass()
    if not mass > 0:
        raise robot.refused([Finding(("urdf",), f"expected a mass > 0, got {mass:g} kg")])
    names = robot.limb_names
    legs = [found.leg(name) for name in names]
    names_by_leg = [leg.names for leg in legs]
    width = max(map(len, names_by_leg))
    lower, upper, posture = (
        by_leg(width, [[values[j] for j in leg.names] for leg in legs], empty)
        for values, empty in zip(joint_angles_of(robot), (-1.0, 1.0, 0.0), strict=True)
    )
    centre = found.center(
        {
            joint: float(angle)
            for leg, row in zip(legs, posture, strict=True)
            for joint, angle in zip(leg.names, row[width - len(leg.names) :], strict=True)
        }
    )
    chain = chain_at_zero(legs, width, centre, posture)
    links = link_masses_of(found, chain, centre, mass)
    if not links.body_mass >= 0:
        legs_mass = links.mass.sum()
        message = f"expected more than the {legs_mass:g} kg of its legs, got {mass:g} kg"
        raise robot.refused([Finding(("mass",), message)])
    stance = chain.joint_points(posture)[:, -1]
    given = np.array([spec.legs[name].stance is not None for name in names])
    for index, name in enumerate(names):
        place = spec.legs[name].stance
        if place is not None:
            stance[index] = place
    if spec.gripper is not None:
        _wrists_have_directions(robot, chain)
    foot = None
    if spec.foot is not None and spec.foot.radius is not None:
        _feet_end_limbs(robot, legs, spec.foot.radius)
        foot = Foot(spec.foot.radius)
    elif spec.foot is not None:
        foot = Foot(sole=sole_of(robot, legs, chain))
        assert foot.sole is not None
        chain = with_soles(chain, foot.sole, spec.foot.center)
        stance = np.where(given[:, None], stance, chain.joint_points(posture)[:, -1])
    turns = None if foot is None or foot.sole is None else foot.sole.level_turns
    chain = _standing(robot, chain, stance, given, (lower, upper), turns)
    first = chain.joint_zero[:, 0]
    shapes = []
    if robot.needs_shapes:
        shapes = collision_shapes(found)
    if not robot.is_stored and spec.gripper is None:
        toes = chain.toe_zero + centre
        if buried := buried_toes(found, legs, toes, shapes):
            raise robot.refused(buried)
    capsules = leg_capsules(
        chain,
        legs,
        shapes,
        centre,
        spec.limb_radii,
        spec.limb_radius,
        None if foot is None or foot.sole is None else sole_capsules(chain, foot.sole),
        0.0 if foot is None else foot.radius,
    )
    radius = spec.limb_radius
    if capsules is not None:
        radius = float(capsules.radius.max())
        if not THICKNESS.holds(radius):
            message = (
                f"the collision geometry of its legs needs capsules of up to {radius:g} m in "
                f"radius, expected {THICKNESS.high:g} m at most; `limb_radius` takes its place"
            )
            raise robot.refused([Finding(("urdf",), message)])
    parts = tuple(part - centre for part in body_parts(shapes))
    bounds = lower, upper
    reach = spec.workspace.reach or common_reach(farthest_toes(chain, *bounds))
    toward = stance - first
    points = chain.joint_points(np.zeros_like(posture))
    made = Robot(
        name=robot.name,
        mass=mass,
        gravity=spec.gravity,
        structural_compliance_share=spec.structural_compliance_share,
        limb_names=names,
        sides=tuple(
            _side(spec.legs[name].side, x) for name, x in zip(names, stance[:, 0], strict=True)
        ),
        shoulder_body=first,
        mount_yaw=np.arctan2(toward[:, 1], toward[:, 0]),
        link_lengths=np.linalg.norm(np.diff(points, axis=1), axis=-1),
        max_torque=joint_limits(robot, names_by_leg, width, "max_torque", "effort"),
        joint_stiffness=joint_stiffness_of(robot, names_by_leg, width),
        joint_lower=lower,
        joint_upper=upper,
        max_joint_speed=joint_limits(robot, names_by_leg, width, "max_speed", "velocity"),
        stance_body=stance,
        body_hull=_hull(robot, first, body_box(shapes), centre),
        reach=reach,
        stance_radius=spec.workspace.stance_radius
        or _ball(robot, chain, stance, reach, bounds, turns),
        limb_radius=LIMB_RADIUS if radius is None else radius,
        mechanism=chain,
        gripper=None if spec.gripper is None else Gripper.from_spec(spec.gripper),
        foot=foot,
        links=links,
        capsules=capsules,
        body_parts=() if spec.body_half_size is not None else parts,
        dynamics=joint_dynamics_of(robot, names_by_leg, width),
    )
    if capsules is None:
        return made
    return replace(made, touching=always_touching(made, made.body_parts or (made.body_hull,)))


def joint_angles_of(
    robot: UrdfRobot,
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Lower and upper bounds and posture of every joint of a leg [rad, m], by name.

    Of joints that follow others: a range that nothing leaves, and zero.
    """
    lower, upper, posture = {}, {}, {}
    for name, joints in robot.joints.items():
        spec = robot.spec.legs[name]
        given = {j: float(np.deg2rad(degrees)) for j, degrees in spec.posture_deg.items()}
        given |= {j: float(place) for j, place in spec.posture_m.items()}
        for joint in joints:
            if joint.mimic is not None:
                lower[joint.name], upper[joint.name], posture[joint.name] = -1.0, 1.0, 0.0
                continue
            low, high = led_bounds(robot.tree, joint, joints)
            if joint.kind == "continuous":
                low, high = max(low, -np.pi), min(high, np.pi)
            rest = 0.0 if low <= 0.0 <= high else (low + high) / 2
            lower[joint.name], upper[joint.name] = low, high
            posture[joint.name] = min(max(given.get(joint.name, rest), low), high)
    return lower, upper, posture


def chain_at_zero(legs: list[LegAtZero], width: int, centre: Array, posture: Array) -> SerialChain:
    """Chains of legs about a centre (3,), those of fewer joints with some that move nothing."""
    count = len(legs)
    joints, axes, slides = (np.zeros((count, width, 3)) for _ in range(3))
    drive = np.broadcast_to(np.eye(width), (count, width, width)).copy()
    for limb, leg in enumerate(legs):
        first = width - len(leg.names)
        joints[limb, :first], joints[limb, first:] = leg.joints[0], leg.joints
        for j, (axis, is_slide) in enumerate(zip(leg.axes, leg.slides, strict=True)):
            (slides if is_slide else axes)[limb, first + j] = axis
            drive[limb, first + j, first + j] = 0.0
            drive[limb, first + j, first + leg.leaders[j]] = leg.ratios[j]
    return SerialChain(
        tuple(("",) * (width - len(leg.names)) + leg.names for leg in legs),
        joints - centre,
        axes,
        np.array([leg.toe for leg in legs]) - centre,
        posture,
        slides if slides.any() else None,
        None if (drive == np.eye(width)).all() else drive,
    )


def _standing(
    robot: UrdfRobot,
    chain: SerialChain,
    stance: Array,
    given: Array,
    bounds: tuple[Array, Array],
    turns: Array | None = None,
) -> SerialChain:
    """The chain with the postures in which it stands; raises SpecError for stances out of reach.

    turns: of last links whose soles lie level.
    """
    lower, upper = bounds
    solution = chain.inverse(stance, lower, upper, turns)
    missed = []
    for limb in (int(i) for i in np.flatnonzero(~solution.valid)):
        why = chain.miss(solution, stance, limb, lower, upper)
        place = ", ".join(f"{x:.3f}" for x in stance[limb])
        message = (
            f"stance ({place}) m cannot be reached, {why.reason} by {1e3 * why.missing:.0f} mm; "
            "expected a toe position in the body frame (x right, y forward, z up, from the centre "
            "of mass)"
        )
        missed.append(Finding(("legs", robot.limb_names[limb], "stance"), message))
    if missed:
        raise robot.refused(missed)
    posture = np.where(given[:, None], solution.best(), chain.posture)
    if turns is not None:  # soles lie level to more digits than postures have
        posture = solution.best()
    return replace(chain, posture=posture)


def _wrists_have_directions(robot: UrdfRobot, chain: SerialChain) -> None:
    """Raises SpecError for toes on the axis of their last joint: wrists count from that link."""
    lost = np.isnan(chain.last_link(chain.posture)).any(axis=(-1, -2))
    message = "lies on the axis of its last joint, so that its wrist has no direction to count from"
    found = [
        Finding(("legs", robot.limb_names[limb], "toe"), message)
        for limb in (int(i) for i in np.flatnonzero(lost))
    ]
    if found:
        raise robot.refused(found)


def _feet_end_limbs(robot: UrdfRobot, legs: list[LegAtZero], radius: float) -> None:
    """Raises SpecError for feet that reach back to the last joint of their leg that turns."""
    found = []
    for name, leg in zip(robot.limb_names, legs, strict=True):
        turns = np.flatnonzero(~np.array(leg.slides))
        last = int(turns.max(initial=0))
        away = float(np.linalg.norm(leg.toe - leg.joints[last]))
        if radius >= away:
            message = (
                f"expected less than {away:g} m, the distance of {name}'s toe from its joint "
                f"{leg.names[last]}, got {radius:g}"
            )
            found.append(Finding(("foot", "radius"), message))
    if found:
        raise robot.refused(found[:1])


def _side(side: str, x: float) -> str:
    if side != "by place":
        return side
    if abs(x) < _ON_MIDDLE:
        return "any"
    return "right" if x > 0 else "left"


def _hull(robot: UrdfRobot, first: Array, box: tuple[Array, Array] | None, centre: Array) -> Array:
    """(8, 3) corners of the body's box; raises SpecError for one out of this world."""
    if robot.spec.body_half_size is not None:
        half = np.array(robot.spec.body_half_size)
        lower, upper = -half, half
    elif box is not None:
        lower, upper = box[0] - centre, box[1] - centre
    else:
        lower, upper = first.min(axis=0), first.max(axis=0)
    middle, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, _THINNEST)
    if not (half <= LENGTH.high).all():
        message = (
            f"the base's collision geometry is {2 * half.max():g} m long, expected "
            f"{2 * LENGTH.high:g} m at most; `body_half_size` takes its place"
        )
        raise robot.refused([Finding(("urdf",), message)])
    return middle + half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def _ball(
    robot: UrdfRobot,
    chain: SerialChain,
    stance: Array,
    reach: float,
    bounds: tuple[Array, Array],
    turns: Array | None = None,
) -> float:
    """Radius of the stance's ball that all legs reach; raises SpecError where there is none."""
    distance = np.linalg.norm(stance - chain.joint_zero[:, 0], axis=1)
    beyond = [
        Finding(
            ("legs", robot.limb_names[limb]),
            f"its toe stands {1e3 * distance[limb]:.0f} mm from its first joint, nearer to full "
            f"stretch than the {1e3 * reach:.0f} mm it is planned with; expected a stance or "
            "posture with bent joints, or `workspace: {reach: NUMBER}`",
        )
        for limb in (int(i) for i in np.flatnonzero(distance > reach))
    ]
    if beyond:
        raise robot.refused(beyond)
    radius = stance_balls(chain, stance, reach, *bounds, turns)
    limb = int(np.argmin(radius))
    if radius[limb] < LEAST_BALL:
        message = (
            f"from its stance the toe of {robot.limb_names[limb]} cannot move "
            f"{1e3 * LEAST_BALL:.0f} mm in every direction within the joint bounds; expected a "
            "stance or posture away from full stretch and from bounds, or "
            "`workspace: {stance_radius: NUMBER}`"
        )
        raise robot.refused([Finding(("legs", robot.limb_names[limb]), message)])
    return float(radius[limb])
