"""Build the arrays that planning computes with, from a checked robot section and its URDF.

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
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.model import MountedCapsules, Robot
from climbplan.robots.self_clearance import find_always_touching
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS, fit_leg_capsules
from climbplan.robots.urdf.drives import (
    pad_to_legs,
    read_joint_dynamics,
    read_joint_limits,
    read_joint_stiffness,
)
from climbplan.robots.urdf.flat_feet import build_sole_capsules, build_soles, move_toes_to_soles
from climbplan.robots.urdf.link_masses import compute_link_masses
from climbplan.robots.urdf.pinocchio_model import LegAtZero, UrdfModel, build_urdf_model
from climbplan.robots.urdf.shapes import (
    CollisionShape,
    build_body_parts,
    compute_body_box,
    read_collision_shapes,
)
from climbplan.robots.urdf.toe_surface import find_buried_toes
from climbplan.robots.urdf.workspace import (
    estimate_reach,
    measure_stance_radii,
    select_common_reach,
)
from climbplan.schema.document import Finding
from climbplan.schema.robots.ranges import LENGTH, THICKNESS
from climbplan.schema.robots.urdf.checks import compute_leader_bounds
from climbplan.schema.robots.urdf.robot import UrdfRobot

_MIN_HALF_EXTENT = 0.02  # [m] of a body
MIN_STANCE_RADIUS = 0.025  # [m] about the stance, below which no step could be planned
_MIDDLE_TOLERANCE = 1e-3  # [m] off the middle plane, within which a toe is on neither side


def build_robot_from_urdf(robot: UrdfRobot) -> Robot:
    """Build the arrays of a robot from a URDF.

    Raises:
        MissingSolver: Pinocchio is not installed.
        SpecError: The URDF has no mass, a mesh cannot be read, or a stance is out of reach; at the
            lines of the section.
    """
    spec, names = robot.spec, robot.limb_names
    urdf_model = build_urdf_model(robot)
    mass = read_mass(urdf_model)
    legs = [urdf_model.read_leg(name) for name in names]
    joints = [leg.names for leg in legs]
    width = max(map(len, joints))
    lower, upper, posture = read_leg_angles(robot, legs, width)
    bounds = lower, upper
    centre = _compute_center(urdf_model, legs, posture)
    chain = build_chain_at_zero(legs, width, centre, posture)
    links = _compute_links(urdf_model, chain, centre, mass)
    chain, stance, foot = _place_feet(robot, legs, chain, bounds)
    shapes = _read_shapes(urdf_model, legs, chain.toe_zero + centre)
    capsules = _fit_capsules(robot, chain, legs, shapes, centre, foot)
    limb_radius = _choose_limb_radius(robot, capsules)
    first = chain.joint_zero[:, 0]
    hull = _build_body_hull(robot, first, compute_body_box(shapes), centre)
    reach = spec.workspace.reach or select_common_reach(estimate_reach(chain, *bounds))
    stance_radius = spec.workspace.stance_radius or _measure_stance_radius(
        robot, chain, stance, reach, bounds, _select_level_turns(foot)
    )
    direction = stance - first
    points = chain.joint_points(np.zeros_like(posture))
    body_parts = tuple(corners - centre for corners in build_body_parts(shapes))
    built = Robot(
        name=robot.name,
        mass=mass,
        gravity=spec.gravity,
        structural_compliance_share=spec.structural_compliance_share,
        limb_names=names,
        sides=_choose_sides(robot, stance),
        shoulder_body=first,
        mount_yaw=np.arctan2(direction[:, 1], direction[:, 0]),
        link_lengths=np.linalg.norm(np.diff(points, axis=1), axis=-1),
        max_torque=read_joint_limits(robot, joints, width, "max_torque", "effort"),
        joint_stiffness=read_joint_stiffness(robot, joints, width),
        joint_lower=lower,
        joint_upper=upper,
        max_joint_speed=read_joint_limits(robot, joints, width, "max_speed", "velocity"),
        stance_body=stance,
        body_hull=hull,
        reach=reach,
        stance_radius=stance_radius,
        limb_radius=limb_radius,
        mechanism=chain,
        gripper=None if spec.gripper is None else Gripper.from_spec(spec.gripper),
        foot=foot,
        links=links,
        capsules=capsules,
        body_parts=() if spec.body_half_size is not None else body_parts,
        dynamics=read_joint_dynamics(robot, joints, width),
    )
    return built if capsules is None else _add_touching_parts(built)


def _add_touching_parts(robot: Robot) -> Robot:
    """Return the robot with the pairs of its parts that touch in every posture."""
    body_parts = robot.body_parts or (robot.body_hull,)
    return replace(robot, touching=find_always_touching(robot, body_parts))


def read_mass(urdf_model: UrdfModel) -> float:
    """Return the mass of the section, else of the URDF [kg]; raises SpecError unless positive."""
    robot = urdf_model.robot
    mass = robot.spec.mass or urdf_model.compute_mass()
    if not mass > 0:
        raise robot.build_error([Finding(("urdf",), f"expected a mass > 0, got {mass:g} kg")])
    return mass


def _compute_center(urdf_model: UrdfModel, legs: list[LegAtZero], posture: Array) -> Array:
    """Return the centre of mass (3,) at joint angles (N, J) from the base link [m]."""
    return urdf_model.compute_center(
        {
            joint: float(angle)
            for leg, row in zip(legs, posture, strict=True)
            for joint, angle in zip(leg.names, row[len(row) - len(leg.names) :], strict=True)
        }
    )


def _compute_links(
    urdf_model: UrdfModel, chain: SerialChain, centre: Array, mass: float
) -> LinkMasses:
    """Return the masses of links; raises SpecError where legs are heavier than the robot."""
    links = compute_link_masses(urdf_model, chain, centre, mass)
    if not links.body_mass >= 0:
        legs_mass = links.mass.sum()
        message = f"expected more than the {legs_mass:g} kg of its legs, got {mass:g} kg"
        raise urdf_model.robot.build_error([Finding(("mass",), message)])
    return links


def _place_feet(
    robot: UrdfRobot, legs: list[LegAtZero], chain: SerialChain, bounds: tuple[Array, Array]
) -> tuple[SerialChain, Array, Foot | None]:
    """Return the chain as it stands, its standing toes (N, 3) [m], and feet of finite size.

    Raises SpecError for stances out of reach and for feet that do not fit the legs.
    """
    spec = robot.spec
    stance = chain.joint_points(chain.posture)[:, -1]
    is_stated = np.array([spec.legs[name].stance is not None for name in robot.limb_names])
    for index, name in enumerate(robot.limb_names):
        position = spec.legs[name].stance
        if position is not None:
            stance[index] = position
    if spec.gripper is not None:
        _check_wrist_directions(robot, chain)
    foot = None
    if spec.foot is not None and spec.foot.radius is not None:
        _check_foot_radius(robot, legs, spec.foot.radius)
        foot = Foot(spec.foot.radius)
    elif spec.foot is not None:
        foot = Foot(sole=build_soles(robot, legs, chain))
        assert foot.sole is not None
        chain = move_toes_to_soles(chain, foot.sole, spec.foot.center)
        toes = chain.joint_points(chain.posture)[:, -1]
        stance = np.where(is_stated[:, None], stance, toes)
    turns = _select_level_turns(foot)
    return _solve_stance(robot, chain, stance, is_stated, bounds, turns), stance, foot


def _select_level_turns(foot: Foot | None) -> Array | None:
    """Return rotations (N, 3, 3) of last links with level soles; None without flat feet."""
    return None if foot is None or foot.sole is None else foot.sole.level_turns


def _read_shapes(urdf_model: UrdfModel, legs: list[LegAtZero], toes: Array) -> list[CollisionShape]:
    """Return collision geometry where it is needed; raises SpecError for toes deep inside of it.

    toes: (N, 3) from the base link [m].
    """
    robot = urdf_model.robot
    shapes = read_collision_shapes(urdf_model) if robot.needs_shapes else []
    if robot.is_stored or robot.spec.gripper is not None:
        return shapes
    if buried := find_buried_toes(urdf_model, legs, toes, shapes):
        raise robot.build_error(buried)
    return shapes


def _fit_capsules(
    robot: UrdfRobot,
    chain: SerialChain,
    legs: list[LegAtZero],
    shapes: list[CollisionShape],
    centre: Array,
    foot: Foot | None,
) -> MountedCapsules | None:
    """Return the capsules of legs in the body frame; None where links are alike and straight.

    centre: origin of the body frame (3,) from the base link [m].
    """
    return fit_leg_capsules(
        chain,
        legs,
        shapes,
        centre,
        stated=robot.spec.limb_radii,
        common=robot.spec.limb_radius,
        soles=None if foot is None or foot.sole is None else build_sole_capsules(chain, foot.sole),
        foot_radius=0.0 if foot is None else foot.radius,
    )


def _choose_limb_radius(robot: UrdfRobot, capsules: MountedCapsules | None) -> float:
    """Return the radius of limbs [m]; raises SpecError for capsules that are too thick."""
    if capsules is None:
        radius = robot.spec.limb_radius
        return LIMB_RADIUS if radius is None else radius
    radius = float(capsules.radius.max())
    if not THICKNESS.holds(radius):
        message = (
            f"the collision geometry of its legs needs capsules of up to {radius:g} m in "
            f"radius, expected {THICKNESS.high:g} m at most; `limb_radius` takes its place"
        )
        raise robot.build_error([Finding(("urdf",), message)])
    return radius


def read_leg_angles(
    robot: UrdfRobot, legs: list[LegAtZero], width: int
) -> tuple[Array, Array, Array]:
    """Return lower and upper bounds and posture (N, J) of the joints of legs [rad, m].

    Args:
        robot: The section and its URDF.
        legs: N legs at zero angles.
        width: J, joints of the longest leg.
    """
    lower, upper, posture = (
        pad_to_legs(width, [[values[j] for j in leg.names] for leg in legs], empty)
        for values, empty in zip(read_joint_angles(robot), (-1.0, 1.0, 0.0), strict=True)
    )
    return lower, upper, posture


def read_joint_angles(
    robot: UrdfRobot,
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return lower and upper bounds and posture of every joint of a leg [rad, m], by name.

    Joints that mimic others have a range that nothing leaves, and zero.
    """
    lower, upper, posture = {}, {}, {}
    for name, joints in robot.joints.items():
        spec = robot.spec.legs[name]
        stated = {j: float(np.deg2rad(degrees)) for j, degrees in spec.posture_deg.items()}
        stated |= {j: float(value) for j, value in spec.posture_m.items()}
        for joint in joints:
            if joint.mimic is not None:
                lower[joint.name], upper[joint.name], posture[joint.name] = -1.0, 1.0, 0.0
                continue
            low, high = compute_leader_bounds(robot.tree, joint, joints)
            if joint.kind == "continuous":
                low, high = max(low, -np.pi), min(high, np.pi)
            default = 0.0 if low <= 0.0 <= high else (low + high) / 2
            lower[joint.name], upper[joint.name] = low, high
            posture[joint.name] = min(max(stated.get(joint.name, default), low), high)
    return lower, upper, posture


def build_chain_at_zero(
    legs: list[LegAtZero], width: int, centre: Array, posture: Array
) -> SerialChain:
    """Return chains of legs about a centre, those of fewer joints padded with fixed ones.

    Args:
        legs: N legs at zero angles.
        width: J, joints of the longest leg.
        centre: Origin of the chains (3,) from the base link [m].
        posture: Joint angles (N, J) from which inverse kinematics starts [rad].
    """
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


def _solve_stance(
    robot: UrdfRobot,
    chain: SerialChain,
    stance: Array,
    is_stated: Array,
    bounds: tuple[Array, Array],
    turns: Array | None = None,
) -> SerialChain:
    """Return the chain with the postures in which it stands; raises SpecError out of reach.

    given: (N,) bool, legs whose stance is stated; turns: (N, 3, 3) of last links whose soles lie
    level.
    """
    lower, upper = bounds
    solution = chain.inverse(stance, lower, upper, turns)
    findings = []
    for limb in (int(i) for i in np.flatnonzero(~solution.valid)):
        miss = chain.explain_miss(solution, stance, limb, lower, upper)
        position = ", ".join(f"{x:.3f}" for x in stance[limb])
        message = (
            f"stance ({position}) m cannot be reached, {miss.reason} by "
            f"{1e3 * miss.missing:.0f} mm; expected a toe position in the body frame (x right, "
            "y forward, z up, from the centre of mass)"
        )
        findings.append(Finding(("legs", robot.limb_names[limb], "stance"), message))
    if findings:
        raise robot.build_error(findings)
    posture = np.where(is_stated[:, None], solution.best(), chain.posture)
    if turns is not None:  # soles lie level to more digits than postures have
        posture = solution.best()
    return replace(chain, posture=posture)


def _check_wrist_directions(robot: UrdfRobot, chain: SerialChain) -> None:
    """Raise SpecError for toes on the axis of their last joint: wrists count from that link."""
    is_undirected = np.isnan(chain.last_link(chain.posture)).any(axis=(-1, -2))
    message = "lies on the axis of its last joint, so that its wrist has no direction to count from"
    findings = [
        Finding(("legs", robot.limb_names[limb], "toe"), message)
        for limb in (int(i) for i in np.flatnonzero(is_undirected))
    ]
    if findings:
        raise robot.build_error(findings)


def _check_foot_radius(robot: UrdfRobot, legs: list[LegAtZero], radius: float) -> None:
    """Raise SpecError for feet that reach back to the last revolute joint of their leg."""
    findings = []
    for name, leg in zip(robot.limb_names, legs, strict=True):
        revolute = np.flatnonzero(~np.array(leg.slides))
        last = int(revolute.max(initial=0))
        distance = float(np.linalg.norm(leg.toe - leg.joints[last]))
        if radius >= distance:
            message = (
                f"expected less than {distance:g} m, the distance of {name}'s toe from its joint "
                f"{leg.names[last]}, got {radius:g}"
            )
            findings.append(Finding(("foot", "radius"), message))
    if findings:
        raise robot.build_error(findings[:1])


def _choose_sides(robot: UrdfRobot, stance: Array) -> tuple[str, ...]:
    """Return the side of each leg with standing toes (N, 3) [m]: as stated, else by position."""
    return tuple(
        _choose_side(robot.spec.legs[name].side, x)
        for name, x in zip(robot.limb_names, stance[:, 0], strict=True)
    )


def _choose_side(side: str, x: float) -> str:
    """Return the side of a leg whose toe stands at x [m]: as stated, else by its place."""
    if side != "by place":
        return side
    if abs(x) < _MIDDLE_TOLERANCE:
        return "any"
    return "right" if x > 0 else "left"


def _build_body_hull(
    robot: UrdfRobot, first_joints: Array, box: tuple[Array, Array] | None, centre: Array
) -> Array:
    """Return the corners (8, 3) of the body's box; raises SpecError if it is too large."""
    if robot.spec.body_half_size is not None:
        half = np.array(robot.spec.body_half_size)
        lower, upper = -half, half
    elif box is not None:
        lower, upper = box[0] - centre, box[1] - centre
    else:
        lower, upper = first_joints.min(axis=0), first_joints.max(axis=0)
    middle, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, _MIN_HALF_EXTENT)
    if not (half <= LENGTH.high).all():
        message = (
            f"the base's collision geometry is {2 * half.max():g} m long, expected "
            f"{2 * LENGTH.high:g} m at most; `body_half_size` takes its place"
        )
        raise robot.build_error([Finding(("urdf",), message)])
    return middle + half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def _measure_stance_radius(
    robot: UrdfRobot,
    chain: SerialChain,
    stance: Array,
    reach: float,
    bounds: tuple[Array, Array],
    turns: Array | None = None,
) -> float:
    """Return the stance radius that all legs reach [m]; raises SpecError where there is none."""
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
        raise robot.build_error(beyond)
    radius = measure_stance_radii(chain, stance, reach, *bounds, turns)
    limb = int(np.argmin(radius))
    if radius[limb] < MIN_STANCE_RADIUS:
        message = (
            f"from its stance the toe of {robot.limb_names[limb]} cannot move "
            f"{1e3 * MIN_STANCE_RADIUS:.0f} mm in every direction within the joint bounds; "
            "expected a stance or posture away from full stretch and from bounds, or "
            "`workspace: {stance_radius: NUMBER}`"
        )
        raise robot.build_error([Finding(("legs", robot.limb_names[limb]), message)])
    return float(radius[limb])
