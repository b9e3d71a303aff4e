"""Build the MuJoCo model of a robot on its terrain, as MJCF text.

The body carries limbs of coxa, femur and tibia. Motors are position servos of stiffness
k (1 - share): the structure's give is counted to the joints, as everywhere in the planner. A toe is
a small sphere about the planned toe point, so surfaces lie its radius deeper than planned; a
spherical foot is one of its own radius, on surfaces where they are; a flat one is a plate.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.limbs import get_foot_radius
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.model.chain_limb import (
    LimbTip,
    build_chain_limb,
    build_joint_ties,
    compute_link_radius,
    find_mimic_joints,
    name_motors,
)
from climbplan.climb.simulation.model.gripper_model import (
    build_gripper,
    build_welds,
    build_wrist_motors,
)
from climbplan.climb.simulation.model.link_masses import select_link_masses
from climbplan.climb.simulation.model.linkage_limb import build_couplers, build_linkage_limb
from climbplan.climb.simulation.model.terrain_geoms import (
    BODY,
    LINK,
    TOE,
    add_mesh,
    build_geom,
    build_scan_geoms,
    build_surface_geoms,
)
from climbplan.climb.simulation.model.toe import TOE_RADIUS, build_sole_plate, compute_toe_radius
from climbplan.climb.simulation.worlds.perturbed_terrain import perturb_terrain
from climbplan.errors import UsageError
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.model import Robot, dynamics_of
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.attributes import format_numbers, write_inertial
from climbplan.simulation.conditions import LIMB_MASS_SHARE, Conditions
from climbplan.simulation.motors import (
    compute_backlash,
    compute_max_torque,
    compute_motor_damping,
    compute_motor_stiffness,
    compute_rotor_inertia,
    compute_viscous_friction,
)
from climbplan.terrain.model import STATED
from climbplan.terrain.raw_surface import NARROW, SLENDER

TIME_STEP = 1e-3  # [s]
_CENTER_TOLERANCE = 1e-6  # [m] off the centre of mass, up to which the body's box is about it
_NUM_CONE_CAPSULES = 6  # capsules of a limb's cone beside a scan
_MIN_LINK_MASS = 1e-3  # [kg] of a link; smaller ones make the equations stiff

# Stops of a joint's backlash. MuJoCo's default stops are as compliant as motors, with which a robot
# falls at negligible backlash. The stiffness of a constraint grows with the inertia that it acts
# on, so what moves within the backlash needs inertia.
_BACKLASH_ARMATURE = 0.01  # [kg m^2] behind the backlash, as of a link of 0.3 kg at 0.18 m
_BACKLASH_DAMPING = 0.02  # [N m s/rad]
_HARD_STOP = 'solreflimit="0.002 1" solimplimit="0.999 0.9999 0.0001"'

_SOLVER = (
    f'<option timestep="{TIME_STEP}" gravity="0 0 {{gravity}}" cone="elliptic" impratio="100"'
    ' integrator="implicitfast" noslip_iterations="4"/>'
)
# MuJoCo's friction lifts a sliding toe by friction times speed times the contact's time constant.
# Stiffer contacts lose a toe that slides at 30 mm/s again and again, and it then slides in another
# direction. Toes penetrate by some 0.6 mm at 30 N, which a margin compensates.
_CONTACT = 'solref="0.01 1" solimp="0.95 0.99 0.001"'
_CONTACT_MARGIN = 0.0006  # [m]
_SKY = '<texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="48"/>'
_VISUAL = (
    '<visual><global offwidth="1280" offheight="960"/><quality shadowsize="2048"/>'
    '<headlight ambient=".45 .45 .45" diffuse=".5 .5 .5"/></visual>'
)


def compute_link_mass(robot: Robot, conditions: Conditions) -> float:
    """Compute the mass of one link [kg]."""
    stated = conditions.limb_mass_share
    limbs_mass = robot.mass * (LIMB_MASS_SHARE if stated is None else stated)
    return float(max(limbs_mass / (robot.joint_count * robot.limb_count), _MIN_LINK_MASS))


def build_mjcf(plan: ClimbPlan, conditions: Conditions) -> str:
    """Build the model of a plan's robot and terrain under conditions.

    Raises:
        UsageError: The robot has grippers on serial chains, or limbs of an unknown kind.
    """
    robot = plan.robot
    if robot.gripper is not None and isinstance(robot.mechanism, SerialChain):
        raise UsageError(
            f"{plan.name}: {robot.name} has grippers on chains of joints, which are not simulated"
        )
    weights = select_link_masses(plan, conditions)
    world, assets = _build_terrain(plan, conditions)
    actuators = [
        line for limb in range(robot.limb_count) for line in _build_motors(robot, limb, conditions)
    ]
    if robot.gripper is not None:
        actuators += build_wrist_motors(robot.gripper, robot.limb_count, conditions)
    tendons, ties = build_couplers(robot)
    ties += build_joint_ties(robot)
    if robot.gripper is not None:
        ties += build_welds(robot.limb_count)
    return "\n".join(
        [
            '<mujoco model="climbplan">',
            _SOLVER.format(gravity=-robot.gravity),
            '<compiler angle="radian" autolimits="true"/>',
            '<size memory="20M"/>',
            _VISUAL,
            f'<default><geom condim="3" {_CONTACT}/></default>',
            "<asset>",
            _SKY,
            '<material name="wall" rgba="0.62 0.66 0.72 0.35"/>',
            '<material name="unused" rgba="0.60 0.60 0.62 0.25"/>',
            '<material name="obstacle" rgba="0.78 0.45 0.30 0.4"/>',
            '<material name="body" rgba="0.16 0.23 0.35 1"/>',
            '<material name="link" rgba="0.35 0.55 0.80 1"/>',
            '<material name="toe" rgba="0.85 0.25 0.20 1"/>',
            *assets,
            "</asset>",
            "<worldbody>",
            '<light pos="0 -2 3" dir="0 0.5 -1" directional="true"/>',
            *world,
            *_build_robot(robot, conditions, _build_limb_tip(plan), weights),
            "</worldbody>",
            "<tendon>",
            *tendons,
            "</tendon>",
            "<equality>",
            *ties,
            "</equality>",
            "<actuator>",
            *actuators,
            "</actuator>",
            "</mujoco>",
        ]
    )


def _build_terrain(plan: ClimbPlan, conditions: Conditions) -> tuple[list[str], list[str]]:
    """Build the geoms of the terrain under conditions, and the assets that they use."""
    assets: list[str] = []
    world: list[str] = []
    terrain = plan.terrain
    if conditions.world is not None:
        terrain = perturb_terrain(terrain, conditions.world)
    friction = float(np.min(plan.instants.mu)) * conditions.friction
    if terrain.scan is not None:
        depth = TOE_RADIUS if plan.robot.foot is None else 0.0
        world += build_scan_geoms(terrain.scan, plan.rounds.toes, friction, assets, depth)
    for index, surface in enumerate(terrain.surfaces):
        if terrain.scan is None or surface.name in STATED:
            world += build_surface_geoms(index, surface, conditions.friction, assets)
    for index, solid in enumerate(terrain.obstacles):
        mesh = add_mesh(f"obstacle{index}", solid, assets)
        world.append(build_geom(f"obstacle{index}", mesh, friction, color="obstacle"))
    return world, assets


def _build_limb_tip(plan: ClimbPlan) -> LimbTip:
    """Return how limbs narrow to their toes: as the planner keeps them off what they stand on.

    That is stated in `climbplan/climb/clearance/limbs.py`, and for scans in
    `climbplan/terrain/raw_surface.py`.
    """
    scan = plan.terrain.scan
    flatness = 0.0 if scan is None else scan.flatness
    foot = get_foot_radius(plan.robot) if scan is None else 0.0
    radius = compute_link_radius(plan.robot)
    min_length = NARROW if foot == 0.0 else 0.0
    length = max((radius + flatness - foot) / SLENDER, min_length)
    if length <= min_length and scan is None:
        return LimbTip(length, (), foot)
    end_distance = flatness / SLENDER if scan is not None else min_length
    distances = np.linspace(length, end_distance, _NUM_CONE_CAPSULES + 1)
    distances = distances[1:-1] if scan is not None else distances[1:]
    radii = np.minimum(foot + SLENDER * distances - flatness, radius)
    cone = tuple((float(d), float(r)) for d, r in zip(distances, radii, strict=True))
    return LimbTip(length, cone, foot)


def _build_robot(
    robot: Robot, conditions: Conditions, tip: LimbTip, weights: LinkMasses | None
) -> list[str]:
    limbs = robot.limb_count
    link_mass = compute_link_mass(robot, conditions)
    world = conditions.world
    total_mass = robot.mass * (1.0 if world is None else world.mass)
    links_mass = (
        robot.joint_count * limbs * link_mass if weights is None else float(weights.mass.sum())
    )
    body_mass = total_mass - links_mass + conditions.payload
    low, high = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    # The mass acts in the origin; a torso that rises over the hips makes a box that is beside it
    center, half_size = (low + high) / 2, (high - low) / 2
    is_off_center = bool(np.abs(center).max() > _CENTER_TOLERANCE)
    mass_center = np.zeros(3)
    if world is not None:
        # The whole mass is off by so much, thus the body's by more
        mass_center = world.com * (total_mass + conditions.payload) / body_mass
    inertial = position_xml = ""
    if weights is not None:
        mass_center = mass_center + weights.body_middle * (weights.body_mass / body_mass)
        inertial = write_inertial(body_mass, mass_center, weights.body_inertia, "the body")
    elif mass_center.any() or is_off_center:
        inertia = body_mass / 3 * ((half_size**2).sum() - half_size**2)
        inertial = (
            f'<inertial pos="{format_numbers(mass_center)}" mass="{body_mass:.9g}" '
            f'diaginertia="{format_numbers(inertia)}"/>'
        )
    if is_off_center:
        position_xml = f' pos="{format_numbers(center)}"'
    box = (
        f'<geom name="body" type="box"{position_xml} size="{format_numbers(half_size)}" '
        f'mass="{body_mass:.9g}" '
        f'material="body" contype="{BODY}" conaffinity="0"/>'
    )
    lines = ['<body name="body">', inertial, '<freejoint name="free"/>', box]
    for limb in range(limbs):
        if robot.mechanism is None:
            lines += _build_limb(robot, limb, link_mass, conditions, tip)
        elif isinstance(robot.mechanism, FiveBar):
            lines += _build_linkage(robot, limb, link_mass, conditions)
        else:
            lines += _build_chain(robot, limb, link_mass, conditions, tip, weights)
    return [*lines, "</body>"]


def _build_limb(
    robot: Robot, limb: int, mass: float, conditions: Conditions, tip: LimbTip
) -> list[str]:
    l1, l2, l3 = robot.link_lengths[limb]
    half_yaw = robot.mount_yaw[limb] / 2
    orientation = format_numbers([np.cos(half_yaw), 0.0, 0.0, np.sin(half_yaw)])
    radius = max(robot.limb_radius, 0.005)
    joints = dict(
        zip(("coxa", "femur", "tibia"), _build_joints(robot, limb, conditions), strict=True)
    )

    def joint(name: str, axis: str) -> str:
        return joints[name].format(name=f"{name}{limb}", axis=axis)

    def link(name: str, end: Array) -> str:
        return (
            f'<geom name="{name}{limb}" type="capsule" fromto="0 0 0 {format_numbers(end)}"'
            f' size="{radius:.6g}" mass="{mass:.9g}" material="link" contype="{LINK}"'
            ' conaffinity="0"/>'
        )

    forward, down = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    toe = _build_end(robot, limb, conditions).format(place=format_numbers(l3 * down))
    visual = (
        f'<geom type="capsule" fromto="0 0 0 {format_numbers((l3 - radius / 4) * down)}"'
        f' size="{radius / 4:.6g}" mass="0" material="link" contype="0" conaffinity="0"/>'
    )
    # A tibia narrows to its toe, as where the planner keeps it clear of what it stands on: what is
    # left of it there is seen but touches nothing.
    return [
        (
            f'<body name="coxa{limb}" pos="{format_numbers(robot.shoulder_body[limb])}" '
            f'quat="{orientation}">'
        ),
        joint("coxa", "0 0 1"),
        link("coxa", l1 * forward),
        f'<body name="femur{limb}" pos="{format_numbers(l1 * forward)}">',
        joint("femur", "0 -1 0"),
        link("femur", l2 * forward),
        f'<body name="tibia{limb}" pos="{format_numbers(l2 * forward)}">',
        joint("tibia", "0 -1 0"),
        link("tibia", max(l3 - tip.length, 0.1 * l3) * down),
        *tip.geoms(l3 * down, LINK),
        visual,
        toe,
        "</body></body></body>",
    ]


def _build_end(robot: Robot, limb: int, conditions: Conditions) -> str:
    """Build the end of a limb, with {place}: a toe, or a gripper on its wrist."""
    if robot.gripper is not None:
        return build_gripper(robot.gripper, limb, max(robot.limb_radius, 0.005), conditions)
    shape = f'type="sphere" pos="{{place}}" size="{compute_toe_radius(robot)}"'
    if robot.sole is not None:
        shape = build_sole_plate(robot, limb)
    return (
        f'<geom name="toe{limb}" {shape} mass="0.001"'
        f' material="toe" contype="{TOE}" conaffinity="0"'
        f' margin="{_CONTACT_MARGIN}" friction="0 0 0"/>'
        f'<site name="toe{limb}" pos="{{place}}" size="0.001"/>'
    )


def _build_joints(robot: Robot, limb: int, conditions: Conditions) -> list[str]:
    """Build the joints of a limb with their backlash, each with {name} and {axis}."""
    joints = []
    parameters = zip(
        compute_backlash(robot, conditions)[limb] / 2,
        robot.joint_unit[limb],
        compute_rotor_inertia(robot, conditions)[limb],
        compute_viscous_friction(robot, conditions)[limb],
        dynamics_of(robot).dry_friction[limb],
        strict=True,
    )
    for play, unit, rotor, viscous, dry in parameters:
        kind = ' type="slide"' if unit != 1.0 else ""
        armature, damping = (x / unit**2 for x in (_BACKLASH_ARMATURE, _BACKLASH_DAMPING))
        attributes = f' armature="{rotor:.9g}"'
        if viscous > 0:
            attributes += f' damping="{viscous:.9g}"'
        if dry > 0:
            attributes += f' frictionloss="{dry:.9g}"'
        joint = f'<joint name="{{name}}"{kind} axis="{{axis}}"{attributes}/>'
        if play > 0:
            joint += (
                f'<joint name="{{name}}play"{kind} axis="{{axis}}" range="{-play:.6g} {play:.6g}"'
                f' armature="{armature:.9g}" damping="{damping:.9g}" {_HARD_STOP}/>'
            )
        joints.append(joint)
    return joints


def _build_chain(
    robot: Robot,
    limb: int,
    mass: float,
    conditions: Conditions,
    tip: LimbTip,
    weights: LinkMasses | None,
) -> list[str]:
    joints = _build_joints(robot, limb, conditions)
    return build_chain_limb(
        robot,
        limb,
        mass,
        joints,
        toe_xml=_build_end(robot, limb, conditions),
        tip=tip,
        contype=LINK,
        weights=weights,
    )


def _build_linkage(robot: Robot, limb: int, mass: float, conditions: Conditions) -> list[str]:
    # Last links end at wrists, or at toes that are seen only: they do not narrow
    joints = _build_joints(robot, limb, conditions)
    return build_linkage_limb(robot, limb, mass, joints, _build_end(robot, limb, conditions), LINK)


def _build_motors(robot: Robot, limb: int, conditions: Conditions) -> list[str]:
    stiffness = compute_motor_stiffness(robot, conditions)[limb]
    damping = compute_motor_damping(robot, conditions)[limb]
    max_torques = compute_max_torque(robot, conditions)[limb]
    lines, mimics = [], find_mimic_joints(robot)[limb]
    for joint, name in enumerate(name_motors(robot, limb)):
        kp, kv = (0.0, 0.0) if mimics[joint] else (stiffness[joint], damping[joint])
        max_torque = max_torques[joint]
        lines.append(
            f'<position name="{name}" joint="{name}" kp="{kp:.9g}" kv="{kv:.9g}"'
            f' forcerange="{-max_torque:.9g} {max_torque:.9g}"/>'
        )
    return lines
