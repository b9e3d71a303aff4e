"""The MuJoCo model of a robot on its terrain, as MJCF text.

The body carries limbs of coxa, femur and tibia. Motors are position servos of stiffness
k (1 - share): the structure's give is counted to the joints, as everywhere in the planner. A toe is
a small sphere about the planned toe point, so surfaces lie its radius deeper than planned.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from xml.sax.saxutils import quoteattr

import numpy as np

from climbplan.climb.limb_clearance import NARROW
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.errors import UsageError
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.simulation.chain_limb import chain_limb, motor_names
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.toe import TOE_RADIUS
from climbplan.simulation.worlds.ground import moved_terrain
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import SLAB_THICKNESS, Region, Surface, Tube

TIME_STEP = 1e-3  # [s]
ARMATURE = 0.05  # [kg m^2] rotor inertia behind the gears of a paired MX-106, assumed
DAMPING_RATIO = 1.0  # of motor and rotor inertia
_NOT_SCANNED = ("left", "right", "ground", "panel", "tube")  # stated by keys of their own
_AROUND = 0.15  # [m] about toes in which raw triangles of a scan are simulated
_PRISM = 0.02  # [m] of material behind them
_STAVES = 96  # flat pieces of a tube
_LEAST_MASS = 1e-3  # [kg] of a link; smaller ones make the equations stiff

# Stops of a joint's play. MuJoCo's own give way by some 200 N m/rad, as much as motors do: with
# them a robot falls of a play of a ten-thousandth of a degree. Contacts are as stiff as what meets
# in them is heavy: what moves within the play must weigh something.
_BEYOND = 0.01  # [kg m^2] beyond the play, a link of 0.3 kg at 0.18 m
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

# Collision classes: toes meet everything, links meet obstacles, the body meets everything.
_TOE, _LINK, _BODY = 1, 2, 4


def motor_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) stiffness of the joints with the structure's give [N m/rad]."""
    share = robot.structural_compliance_share
    stiffness = np.asarray(robot.joint_stiffness * (1 - share) * conditions.gain)
    world = conditions.world
    return stiffness if world is None else stiffness * world.gain * world.stiffness


def believed_stiffness(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) what whoever commands the joints takes it for [N m/rad]."""
    return motor_stiffness(robot, replace(conditions, gain=1.0, world=None))


def plays(robot: Robot, conditions: Conditions) -> Array:
    """(N, J) play of the joints [rad]."""
    own = np.full((robot.limb_count, robot.joint_count), conditions.backlash)
    return own if conditions.world is None else own + conditions.world.backlash


def link_mass(robot: Robot, conditions: Conditions) -> float:
    """Mass of one link [kg]."""
    share = robot.mass * conditions.limb_mass_share
    return float(max(share / (robot.joint_count * robot.limb_count), _LEAST_MASS))


def build_mjcf(plan: ClimbPlan, conditions: Conditions) -> str:
    """The model of a plan's robot and terrain under given conditions.

    Raises UsageError for limbs that it does not know, and for grippers.
    """
    robot = plan.robot
    if robot.gripper is not None:
        raise UsageError(f"{plan.name}: {robot.name} has grippers, which are not simulated")
    if isinstance(robot.mechanism, FiveBar):
        raise UsageError(f"{plan.name}: {robot.name} has five-bar legs, which are not simulated")
    assets: list[str] = []
    world: list[str] = []
    terrain = plan.terrain
    if conditions.world is not None:
        terrain = moved_terrain(terrain, conditions.world)
    friction = float(np.min(plan.instants.mu)) * conditions.friction
    if terrain.scan is not None:
        world += raw_geoms(terrain.scan, plan.rounds.toes, friction, assets)
    for index, surface in enumerate(terrain.surfaces):
        if terrain.scan is None or surface.name in _NOT_SCANNED:
            world += _surface(index, surface, conditions.friction, assets)
    for index, solid in enumerate(terrain.obstacles):
        mesh = _mesh(f"obstacle{index}", solid, assets)
        world.append(
            _terrain_geom(f"obstacle{index}", mesh, friction, links=True, color="obstacle")
        )
    actuators = [
        line for limb in range(robot.limb_count) for line in _motors(robot, limb, conditions)
    ]
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
            *_robot(robot, conditions),
            "</worldbody>",
            "<actuator>",
            *actuators,
            "</actuator>",
            "</mujoco>",
        ]
    )


def _numbers(values: Iterable[float] | Array) -> str:
    return " ".join(f"{v:.9g}" for v in np.ravel(np.asarray(values, float)))


def _robot(robot: Robot, conditions: Conditions) -> list[str]:
    limbs = robot.limb_count
    link = link_mass(robot, conditions)
    world = conditions.world
    whole = robot.mass * (1.0 if world is None else world.mass)
    body = whole - robot.joint_count * limbs * link + conditions.payload
    size = np.abs(robot.body_hull).max(axis=0)
    inertial = ""
    if world is not None and world.com.any():
        # The whole mass is off by so much, thus the body's by more
        place = world.com * (whole + conditions.payload) / body
        inertia = body / 3 * ((size**2).sum() - size**2)
        inertial = (
            f'<inertial pos="{_numbers(place)}" mass="{body:.9g}"'
            f' diaginertia="{_numbers(inertia)}"/>'
        )
    box = (
        f'<geom name="body" type="box" size="{_numbers(size)}" mass="{body:.9g}" material="body"'
        f' contype="{_BODY}" conaffinity="0"/>'
    )
    lines = ['<body name="body">', inertial, '<freejoint name="free"/>', box]
    for limb in range(limbs):
        one = _limb if robot.mechanism is None else _chain
        lines += one(robot, limb, link, conditions)
    return [*lines, "</body>"]


def _limb(robot: Robot, limb: int, mass: float, conditions: Conditions) -> list[str]:
    l1, l2, l3 = robot.link_lengths[limb]
    half = robot.mount_yaw[limb] / 2
    turn = _numbers([np.cos(half), 0.0, 0.0, np.sin(half)])
    radius = max(robot.limb_radius, 0.005)
    own_plays = dict(zip(("coxa", "femur", "tibia"), plays(robot, conditions)[limb], strict=True))

    def joint(name: str, axis: str) -> str:
        own = f'<joint name="{name}{limb}" axis="{axis}" armature="{ARMATURE}"/>'
        play = own_plays[name] / 2
        if play > 0:
            own += (
                f'<joint name="{name}{limb}play" axis="{axis}" range="{-play:.6g} {play:.6g}"'
                f' armature="{_BEYOND}" damping="0.02" {_HARD_STOP}/>'
            )
        return own

    def link(name: str, end: Array) -> str:
        return (
            f'<geom name="{name}{limb}" type="capsule" fromto="0 0 0 {_numbers(end)}"'
            f' size="{radius:.6g}" mass="{mass:.9g}" material="link" contype="{_LINK}"'
            ' conaffinity="0"/>'
        )

    along, down = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    toe = (
        f'<geom name="toe{limb}" type="sphere" pos="{_numbers(l3 * down)}" size="{TOE_RADIUS}"'
        f' mass="0.001" material="toe" contype="{_TOE}" conaffinity="0" margin="{_STANDS_IN}"'
        ' friction="0 0 0"/>'
        f'<site name="toe{limb}" pos="{_numbers(l3 * down)}" size="0.001"/>'
    )
    narrow = (
        f'<geom type="capsule" fromto="0 0 0 {_numbers((l3 - radius / 4) * down)}"'
        f' size="{radius / 4:.6g}" mass="0" material="link" contype="0" conaffinity="0"/>'
    )
    # A tibia narrows to its toe, as where the planner keeps it clear of what it stands on: what is
    # left of it there is seen but touches nothing.
    return [
        f'<body name="coxa{limb}" pos="{_numbers(robot.shoulder_body[limb])}" quat="{turn}">',
        joint("coxa", "0 0 1"),
        link("coxa", l1 * along),
        f'<body name="femur{limb}" pos="{_numbers(l1 * along)}">',
        joint("femur", "0 -1 0"),
        link("femur", l2 * along),
        f'<body name="tibia{limb}" pos="{_numbers(l2 * along)}">',
        joint("tibia", "0 -1 0"),
        link("tibia", max(l3 - NARROW, 0.1 * l3) * down),
        narrow,
        toe,
        "</body></body></body>",
    ]


def _chain(robot: Robot, limb: int, mass: float, conditions: Conditions) -> list[str]:
    joints = []
    for play in plays(robot, conditions)[limb] / 2:
        joint = f'<joint name="{{name}}" axis="{{axis}}" armature="{ARMATURE}"/>'
        if play > 0:
            joint += (
                f'<joint name="{{name}}play" axis="{{axis}}" range="{-play:.6g} {play:.6g}"'
                f' armature="{_BEYOND}" damping="0.02" {_HARD_STOP}/>'
            )
        joints.append(joint)
    toe = (
        f'<geom name="toe{limb}" type="sphere" pos="{{place}}" size="{TOE_RADIUS}" mass="0.001"'
        f' material="toe" contype="{_TOE}" conaffinity="0" margin="{_STANDS_IN}" friction="0 0 0"/>'
        f'<site name="toe{limb}" pos="{{place}}" size="0.001"/>'
    )
    return chain_limb(robot, limb, mass, joints, toe, NARROW, _LINK)


def _motors(robot: Robot, limb: int, conditions: Conditions) -> list[str]:
    stiffness = motor_stiffness(robot, conditions)[limb]
    out = []
    for joint, name in enumerate(motor_names(robot, limb)):
        kp = stiffness[joint]
        kv = 2 * DAMPING_RATIO * np.sqrt(kp * ARMATURE)
        most = robot.max_torque[limb, joint]
        out.append(
            f'<position name="{name}" joint="{name}" kp="{kp:.9g}" kv="{kv:.9g}"'
            f' forcerange="{-most:.9g} {most:.9g}"/>'
        )
    return out


def _terrain_geom(
    name: str, shape: str, friction: float, *, links: bool = False, color: str = "wall"
) -> str:
    meets = _TOE | _BODY | (_LINK if links else 0)
    return (
        f'<geom name={quoteattr(name)} {shape} friction="{max(friction, 1e-5):.6g} 0 0"'
        f' contype="0" conaffinity="{meets}" material="{color}"/>'
    )


def _surface(index: int, surface: Surface, factor: float, assets: list[str]) -> list[str]:
    name, friction = f"surface{index}", surface.friction * factor
    if isinstance(surface, Tube):
        return _tube(name, surface, friction)
    assert isinstance(surface, Region)
    vertices = surface.vertices - TOE_RADIUS * surface.normal
    edges = np.roll(vertices, -1, axis=0) - vertices
    corners = np.abs(np.einsum("ki,ki->k", edges, np.roll(edges, -1, axis=0)))
    if len(vertices) == 4 and corners.max() < 1e-9:
        width, height = np.linalg.norm(edges[0]), np.linalg.norm(edges[1])
        axes = np.stack([edges[0] / width, edges[1] / height, surface.normal], axis=1)
        center = vertices.mean(axis=0) - SLAB_THICKNESS / 2 * surface.normal
        half = np.array([width, height, SLAB_THICKNESS]) / 2
        return [_terrain_geom(name, _box(center, axes, half), friction)]
    deep = np.vstack([vertices, vertices - SLAB_THICKNESS * surface.normal])
    return [_terrain_geom(name, _mesh(name, Solid.from_points(name, deep), assets), friction)]


def raw_geoms(scan: RawSurface, toes: Array, friction: float, assets: list[str]) -> list[str]:
    """The raw triangles of a scan as thin prisms, those within a stride of toes (..., 3).

    Their fronts are the toe's radius behind the triangles, so that toes stand on these.
    """
    corners = scan.corners
    low, high = corners.min(axis=1) - _AROUND, corners.max(axis=1) + _AROUND
    places = np.unique(np.round(toes.reshape(-1, 3), 3), axis=0)
    near = np.zeros(len(corners), bool)
    for place in places:
        near |= ((place >= low) & (place <= high)).all(axis=1)
    out = []
    for t in np.flatnonzero(near):
        doubled = np.cross(corners[t, 1] - corners[t, 0], corners[t, 2] - corners[t, 0])
        normal = doubled / np.linalg.norm(doubled)
        front = corners[t] - TOE_RADIUS * normal
        name = f"scan{t}"
        assets.append(_prism(name, np.vstack([front, front - _PRISM * normal])))
        shape = f'type="mesh" mesh="{name}" pos="{_numbers(front.mean(axis=0))}"'
        out.append(_terrain_geom(name, shape, friction, links=True))
    return out


def _prism(name: str, vertices: Array) -> str:
    """A triangle's prism as a mesh about the middle of its front."""
    own = vertices - vertices[:3].mean(axis=0)
    return f'<mesh name="{name}" inertia="shell" vertex="{_numbers(own)}"/>'


def _box(center: Array, axes: Array, half: Array) -> str:
    """axes: (3, 3), columns the box's axes in the world."""
    return (
        f'type="box" pos="{_numbers(center)}" size="{_numbers(half)}"'
        f' xyaxes="{_numbers(axes[:, 0])} {_numbers(axes[:, 1])}"'
    )


def _mesh(name: str, solid: Solid, assets: list[str]) -> str:
    center = solid.vertices.mean(axis=0)
    assets.append(f'<mesh name="{name}" vertex="{_numbers(solid.vertices - center)}"/>')
    # MuJoCo moves a mesh's vertices to its own centre and principal axes, and back where it stands.
    return f'type="mesh" mesh="{name}" pos="{_numbers(center)}"'


def _tube(name: str, tube: Tube, friction: float) -> list[str]:
    """Staves whose inner faces touch the tube, the toe's radius further out."""
    out = []
    radius = tube.radius + TOE_RADIUS
    half = np.array(
        [radius * np.tan(np.pi / _STAVES), (tube.upper - tube.lower) / 2, SLAB_THICKNESS / 2]
    )
    # Midway between the circles through the corners and the middles of the faces
    inner = radius * (1 + np.cos(np.pi / _STAVES)) / 2
    for stave in range(_STAVES):
        angle = 2 * np.pi * stave / _STAVES
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = np.stack([[-outward[1], outward[0], 0.0], [0.0, 0.0, 1.0], outward], axis=1)
        center = np.array([*tube.center, (tube.lower + tube.upper) / 2], float)
        center = center + (inner + SLAB_THICKNESS / 2) * outward
        out.append(_terrain_geom(f"{name}.{stave}", _box(center, axes, half), friction))
    return out
