"""The MuJoCo model of a robot on its terrain, as MJCF text.

The body carries limbs of coxa, femur and tibia. Motors are position servos of stiffness
k (1 - share): the structure's give is counted to the joints, as everywhere in the planner. A toe is
a small sphere about the planned toe point, so surfaces lie its radius deeper than planned; a
spherical foot is one of its own radius, on surfaces where they are; a flat one is a plate.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.limbs import foot_radius
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.model.chain_limb import (
    Narrow,
    chain_limb,
    followers,
    motor_names,
    thickness_of,
    ties_of_absent,
)
from climbplan.climb.simulation.model.gripper_model import gripper_end, welds, wrist_motors
from climbplan.climb.simulation.model.link_masses import link_masses
from climbplan.climb.simulation.model.linkage_limb import couplers, linkage_limb
from climbplan.climb.simulation.model.terrain_geoms import (
    BODY,
    LINK,
    TOE,
    mesh_shape,
    raw_geoms,
    surface_geoms,
    terrain_geom,
)
from climbplan.climb.simulation.model.toe import TOE_RADIUS, sole_plate, toe_radius
from climbplan.climb.simulation.worlds.ground import moved_terrain
from climbplan.errors import UsageError
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.model import Robot, dynamics_of
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.attributes import inertial_of, numbers
from climbplan.simulation.conditions import LIMB_MASS_SHARE, Conditions
from climbplan.simulation.motors import (
    motor_damping,
    motor_stiffness,
    plays,
    rotor_inertia,
    viscous_friction,
)
from climbplan.terrain.model import STATED
from climbplan.terrain.raw_surface import NARROW, SLENDER

TIME_STEP = 1e-3  # [s]
_CENTRED = 1e-6  # [m] off the centre of mass, up to which the body's box is about it
_CONE = 6  # capsules of a limb's cone beside a scan
_LEAST_MASS = 1e-3  # [kg] of a link; smaller ones make the equations stiff

# Stops of a joint's play. MuJoCo's own give way by some 200 N m/rad, as much as motors do: with
# them a robot falls of a play of a ten-thousandth of a degree. Contacts are as stiff as what meets
# in them is heavy: what moves within the play must weigh something.
_BEYOND = 0.01  # [kg m^2] beyond the play, a link of 0.3 kg at 0.18 m
_BEYOND_DAMPING = 0.02  # [N m s/rad]
_HARD_STOP = 'solreflimit="0.002 1" solimplimit="0.999 0.9999 0.0001"'

_SOLVER = (
    f'<option timestep="{TIME_STEP}" gravity="0 0 {{gravity}}" cone="elliptic" impratio="100"'
    ' integrator="implicitfast" noslip_iterations="4"/>'
)
# MuJoCo's friction lifts a toe as it slides, by friction times speed times the contact's time
# constant. Stiffer contacts than these lose the toe at 30 mm/s, which falls back after a
# millisecond, eight times in a twentieth of a second, and slides another way than friction lets it.
# Toes sink in by some 0.6 mm of 30 N (limbs give some 30 mm), which a margin gives back.
_CONTACT = 'solref="0.01 1" solimp="0.95 0.99 0.001"'
_STANDS_IN = 0.0006  # [m]
_SKY = '<texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="48"/>'
_VISUAL = (
    '<visual><global offwidth="1280" offheight="960"/><quality shadowsize="2048"/>'
    '<headlight ambient=".45 .45 .45" diffuse=".5 .5 .5"/></visual>'
)


def link_mass(robot: Robot, conditions: Conditions) -> float:
    """Mass of one link [kg]."""
    part = conditions.limb_mass_share
    share = robot.mass * (LIMB_MASS_SHARE if part is None else part)
    return float(max(share / (robot.joint_count * robot.limb_count), _LEAST_MASS))


def build_mjcf(plan: ClimbPlan, conditions: Conditions) -> str:
    """The model of a plan's robot and terrain under given conditions.

    Raises UsageError for limbs that it does not know.
    """
    robot = plan.robot
    if robot.gripper is not None and isinstance(robot.mechanism, SerialChain):
        raise UsageError(
            f"{plan.name}: {robot.name} has grippers on chains of joints, which are not simulated"
        )
    weights = link_masses(plan, conditions)
    assets: list[str] = []
    world: list[str] = []
    terrain = plan.terrain
    if conditions.world is not None:
        terrain = moved_terrain(terrain, conditions.world)
    friction = float(np.min(plan.instants.mu)) * conditions.friction
    if terrain.scan is not None:
        behind = TOE_RADIUS if robot.foot is None else 0.0
        world += raw_geoms(terrain.scan, plan.rounds.toes, friction, assets, behind)
    for index, surface in enumerate(terrain.surfaces):
        if terrain.scan is None or surface.name in STATED:
            world += surface_geoms(index, surface, conditions.friction, assets)
    for index, solid in enumerate(terrain.obstacles):
        mesh = mesh_shape(f"obstacle{index}", solid, assets)
        world.append(terrain_geom(f"obstacle{index}", mesh, friction, color="obstacle"))
    actuators = [
        line for limb in range(robot.limb_count) for line in _motors(robot, limb, conditions)
    ]
    if robot.gripper is not None:
        actuators += wrist_motors(robot.gripper, robot.limb_count, conditions)
    tendons, ties = couplers(robot)
    ties += ties_of_absent(robot)
    if robot.gripper is not None:
        ties += welds(robot.limb_count)
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
            *_robot(robot, conditions, _narrow_part(plan), weights),
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


def _narrow_part(plan: ClimbPlan) -> Narrow:
    """Return how limbs narrow to their toes: as the planner keeps them off what they stand on.

    That is stated in `climbplan/climb/clearance/limbs.py`, and for scans in
    `climbplan/terrain/raw_surface.py`.
    """
    scan = plan.terrain.scan
    flatness = 0.0 if scan is None else scan.flatness
    foot = foot_radius(plan.robot) if scan is None else 0.0
    radius = thickness_of(plan.robot)
    first = NARROW if foot == 0.0 else 0.0
    whole = max((radius + flatness - foot) / SLENDER, first)
    if whole <= first and scan is None:
        return Narrow(whole, (), foot)
    ends = flatness / SLENDER if scan is not None else first
    far = np.linspace(whole, ends, _CONE + 1)
    far = far[1:-1] if scan is not None else far[1:]
    thick = np.minimum(foot + SLENDER * far - flatness, radius)
    cone = tuple((float(d), float(r)) for d, r in zip(far, thick, strict=True))
    return Narrow(whole, cone, foot)


def _robot(
    robot: Robot, conditions: Conditions, narrow: Narrow, weights: LinkMasses | None
) -> list[str]:
    limbs = robot.limb_count
    link = link_mass(robot, conditions)
    world = conditions.world
    whole = robot.mass * (1.0 if world is None else world.mass)
    links = robot.joint_count * limbs * link if weights is None else float(weights.mass.sum())
    body = whole - links + conditions.payload
    low, high = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    # The mass acts in the origin; a torso that rises over the hips makes a box that is beside it
    middle, size = (low + high) / 2, (high - low) / 2
    beside = bool(np.abs(middle).max() > _CENTRED)
    place = np.zeros(3)
    if world is not None:
        # The whole mass is off by so much, thus the body's by more
        place = world.com * (whole + conditions.payload) / body
    inertial = at = ""
    if weights is not None:
        place = place + weights.body_middle * (weights.body_mass / body)
        inertial = inertial_of(body, place, weights.body_inertia, "the body")
    elif place.any() or beside:
        inertia = body / 3 * ((size**2).sum() - size**2)
        inertial = (
            f'<inertial pos="{numbers(place)}" mass="{body:.9g}" diaginertia="{numbers(inertia)}"/>'
        )
    if beside:
        at = f' pos="{numbers(middle)}"'
    box = (
        f'<geom name="body" type="box"{at} size="{numbers(size)}" mass="{body:.9g}" '
        f'material="body" contype="{BODY}" conaffinity="0"/>'
    )
    lines = ['<body name="body">', inertial, '<freejoint name="free"/>', box]
    for limb in range(limbs):
        if robot.mechanism is None:
            lines += _limb(robot, limb, link, conditions, narrow)
        elif isinstance(robot.mechanism, FiveBar):
            lines += _linkage(robot, limb, link, conditions)
        else:
            lines += _chain(robot, limb, link, conditions, narrow, weights)
    return [*lines, "</body>"]


def _limb(
    robot: Robot, limb: int, mass: float, conditions: Conditions, narrow: Narrow
) -> list[str]:
    l1, l2, l3 = robot.link_lengths[limb]
    half = robot.mount_yaw[limb] / 2
    turn = numbers([np.cos(half), 0.0, 0.0, np.sin(half)])
    radius = max(robot.limb_radius, 0.005)
    joints = dict(zip(("coxa", "femur", "tibia"), _joints(robot, limb, conditions), strict=True))

    def joint(name: str, axis: str) -> str:
        return joints[name].format(name=f"{name}{limb}", axis=axis)

    def link(name: str, end: Array) -> str:
        return (
            f'<geom name="{name}{limb}" type="capsule" fromto="0 0 0 {numbers(end)}"'
            f' size="{radius:.6g}" mass="{mass:.9g}" material="link" contype="{LINK}"'
            ' conaffinity="0"/>'
        )

    along, down = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    toe = _end(robot, limb, conditions).format(place=numbers(l3 * down))
    seen = (
        f'<geom type="capsule" fromto="0 0 0 {numbers((l3 - radius / 4) * down)}"'
        f' size="{radius / 4:.6g}" mass="0" material="link" contype="0" conaffinity="0"/>'
    )
    # A tibia narrows to its toe, as where the planner keeps it clear of what it stands on: what is
    # left of it there is seen but touches nothing.
    return [
        f'<body name="coxa{limb}" pos="{numbers(robot.shoulder_body[limb])}" quat="{turn}">',
        joint("coxa", "0 0 1"),
        link("coxa", l1 * along),
        f'<body name="femur{limb}" pos="{numbers(l1 * along)}">',
        joint("femur", "0 -1 0"),
        link("femur", l2 * along),
        f'<body name="tibia{limb}" pos="{numbers(l2 * along)}">',
        joint("tibia", "0 -1 0"),
        link("tibia", max(l3 - narrow.length, 0.1 * l3) * down),
        *narrow.geoms(l3 * down, LINK),
        seen,
        toe,
        "</body></body></body>",
    ]


def _end(robot: Robot, limb: int, conditions: Conditions) -> str:
    """What is at a limb's end, with {place}: a toe, or a gripper on its wrist."""
    if robot.gripper is not None:
        return gripper_end(robot.gripper, limb, max(robot.limb_radius, 0.005), conditions)
    shape = f'type="sphere" pos="{{place}}" size="{toe_radius(robot)}"'
    if robot.sole is not None:
        shape = sole_plate(robot, limb)
    return (
        f'<geom name="toe{limb}" {shape} mass="0.001"'
        f' material="toe" contype="{TOE}" conaffinity="0" margin="{_STANDS_IN}" friction="0 0 0"/>'
        f'<site name="toe{limb}" pos="{{place}}" size="0.001"/>'
    )


def _joints(robot: Robot, limb: int, conditions: Conditions) -> list[str]:
    """Joints of a limb with their play, each with {name} and {axis}."""
    joints = []
    own = zip(
        plays(robot, conditions)[limb] / 2,
        robot.joint_unit[limb],
        rotor_inertia(robot, conditions)[limb],
        viscous_friction(robot, conditions)[limb],
        dynamics_of(robot).dry_friction[limb],
        strict=True,
    )
    for play, unit, rotor, viscous, dry in own:
        kind = ' type="slide"' if unit != 1.0 else ""
        beyond, damping = (x / unit**2 for x in (_BEYOND, _BEYOND_DAMPING))
        resists = f' armature="{rotor:.9g}"'
        if viscous > 0:
            resists += f' damping="{viscous:.9g}"'
        if dry > 0:
            resists += f' frictionloss="{dry:.9g}"'
        joint = f'<joint name="{{name}}"{kind} axis="{{axis}}"{resists}/>'
        if play > 0:
            joint += (
                f'<joint name="{{name}}play"{kind} axis="{{axis}}" range="{-play:.6g} {play:.6g}"'
                f' armature="{beyond:.9g}" damping="{damping:.9g}" {_HARD_STOP}/>'
            )
        joints.append(joint)
    return joints


def _chain(
    robot: Robot,
    limb: int,
    mass: float,
    conditions: Conditions,
    narrow: Narrow,
    weights: LinkMasses | None,
) -> list[str]:
    joints = _joints(robot, limb, conditions)
    return chain_limb(
        robot, limb, mass, joints, _end(robot, limb, conditions), narrow, LINK, weights
    )


def _linkage(robot: Robot, limb: int, mass: float, conditions: Conditions) -> list[str]:
    # Last links end at wrists, or at toes that are seen only: they do not narrow
    joints = _joints(robot, limb, conditions)
    return linkage_limb(robot, limb, mass, joints, _end(robot, limb, conditions), LINK)


def _motors(robot: Robot, limb: int, conditions: Conditions) -> list[str]:
    stiffness = motor_stiffness(robot, conditions)[limb]
    damping = motor_damping(robot, conditions)[limb]
    out, driven = [], followers(robot)[limb]
    for joint, name in enumerate(motor_names(robot, limb)):
        kp, kv = (0.0, 0.0) if driven[joint] else (stiffness[joint], damping[joint])
        most = robot.max_torque[limb, joint]
        out.append(
            f'<position name="{name}" joint="{name}" kp="{kp:.9g}" kv="{kv:.9g}"'
            f' forcerange="{-most:.9g} {most:.9g}"/>'
        )
    return out
