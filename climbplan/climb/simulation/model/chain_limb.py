"""A limb that is a chain of joints, as nested MuJoCo bodies.

At zero angles all links' frames are parallel to the body's, so that every joint is placed by where
it lies beyond the one before and turns about its axis at zero angles.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.model import MountedCapsules, Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.attributes import inertial_of, numbers
from climbplan.terrain.raw_surface import SLENDER

_SHORTEST = 0.01  # [m] of a link that is drawn and touches
_THINNEST = 0.005  # [m] radius of a link
_FOOT = 1e-3  # [m] by which the capsule of a foot may reach beyond its sphere
_POINT = 1e-6  # [m] an axis this short is none
_STIFF = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'
_NO_MASS = 1e-4  # [kg] of a body where a limb has no joint
_ANY_AXIS = np.array([0.0, 0.0, 1.0])  # about which it does not turn
_MASSIVE = 1e-7  # [kg m^2] inertia of a link without length


@dataclass(frozen=True)
class Narrow:
    """The end of a limb, that narrows to its toe."""

    length: float  # [m] of the last link that is not as thick as its others
    cone: tuple[tuple[float, float], ...]  # what of it touches: distances from the toe, radii [m]
    foot: float = 0.0  # [m] radius of the spherical foot that it narrows to

    def geoms(self, toe: Array, contype: int) -> list[str]:
        """Capsules from each place to the next, as thick as at the thinner end; toe: (3,)."""
        length = float(np.linalg.norm(toe))
        out = []
        for (far, _), (near, radius) in itertools.pairwise(((self.length, 0.0), *self.cone)):
            if far > 0.9 * length:
                continue
            ends = np.concatenate([(1 - far / length) * toe, (1 - near / length) * toe])
            out.append(
                f'<geom type="capsule" fromto="{numbers(ends)}" size="{radius:.6g}" mass="0"'
                f' material="link" contype="{contype}" conaffinity="0"/>'
            )
        return out


def chain_of(robot: Robot) -> SerialChain:
    """The chains of a robot that can be simulated; raises UsageError for others."""
    chain = robot.mechanism
    if not isinstance(chain, SerialChain):
        raise UsageError(f"simulate does not know the limbs of {robot.name}")
    return chain


def ties_of_absent(robot: Robot) -> list[str]:
    """What holds the joints at zero that limbs with fewer joints than others have not.

    Arrays of joints are as wide as the longest limb: the first of a shorter one are bodies without
    mass to speak of at the place of its first joint. Joints that mimic others are tied to these.
    """
    if robot.mechanism is None:
        return []
    driven, ties = followers(robot), []
    for limb in range(robot.limb_count):
        names = motor_names(robot, limb)
        for joint in np.flatnonzero(~robot.has_joint[limb]):
            if driven[limb, joint]:
                row = drive_of(robot)[limb, joint]
                leader = int(np.argmax(np.abs(row)))
                ties.append(
                    f'<joint joint1="{names[joint]}" joint2="{names[leader]}" '
                    f'polycoef="0 {row[leader]:.12g} 0 0 0" {_STIFF}/>'
                )
            else:
                ties.append(f'<joint joint1="{names[joint]}" polycoef="0 0 0 0 0" {_STIFF}/>')
    return ties


def drive_of(robot: Robot) -> Array:
    """(N, J, J) how far joints move by angles: the identity unless some mimic others."""
    if isinstance(robot.mechanism, SerialChain):
        return robot.mechanism.drives
    return np.broadcast_to(
        np.eye(robot.joint_count), (robot.limb_count, robot.joint_count, robot.joint_count)
    )


def followers(robot: Robot) -> BoolArray:
    """(N, J) joints that mimic others."""
    return np.asarray(np.diagonal(drive_of(robot), axis1=-2, axis2=-1) == 0.0)


def motor_names(robot: Robot, limb: int) -> list[str]:
    """Names of a limb's joints and motors in the model, from the body to the toe."""
    if robot.mechanism is None:
        return [f"{joint}{limb}" for joint in ("coxa", "femur", "tibia")]
    return [f"joint{j}limb{limb}" for j in range(robot.joint_count)]


def chain_limb(
    robot: Robot,
    limb: int,
    mass: float,
    joints_xml: Sequence[str],
    toe_xml: str,
    narrow: Narrow,
    contype: int,
    weights: LinkMasses | None = None,
) -> list[str]:
    """Lines of one limb.

    mass: of each link [kg], unless weights say more. joints_xml: each joint with {name} and
    {axis}; toe_xml: the toe with {place}. narrow: the end of the last link. contype: collision
    class of links.
    """
    chain = chain_of(robot)
    points = np.concatenate([chain.joint_zero[limb], chain.toe_zero[limb][None]])
    radius = thickness_of(robot)
    lines: list[str] = []
    before = np.zeros(3)
    shape_mass = mass if weights is None else 0.0
    for j, name in enumerate(motor_names(robot, limb)):
        end = points[j + 1] - points[j]
        there = bool(chain.names[limb][j])
        axis = chain.axis_zero[limb, j] if there else _ANY_AXIS
        if chain.slide_zero is not None and chain.sliding[limb, j]:
            axis = chain.slide_zero[limb, j]
        own = mass if there else _NO_MASS
        lines += [
            f'<body name="{name}" pos="{numbers(points[j] - before)}">',
            joints_xml[j].format(name=name, axis=numbers(axis)),
        ]
        length = float(np.linalg.norm(end))
        if weights is not None:
            lines.append(
                inertial_of(
                    weights.mass[limb, j],
                    weights.middle[limb, j],
                    weights.inertia[limb, j],
                    f"the link moved by {chain.names[limb][j] or name}",
                )
            )
        elif length < _SHORTEST:
            lines.append(
                f'<inertial pos="0 0 0" mass="{own:.9g}" diaginertia="{_MASSIVE} {_MASSIVE} '
                f'{_MASSIVE}"/>'
            )
        if length >= _SHORTEST:
            last = j == robot.joint_count - 1
            part = max(length - narrow.length, 0.1 * length) / length if last else 1.0
            touches = contype if robot.capsules is None else 0
            lines.append(
                f'<geom name="{name}" type="capsule" fromto="0 0 0 {numbers(part * end)}" '
                f'size="{radius:.6g}" mass="{shape_mass:.9g}" material="link" contype="{touches}" '
                'conaffinity="0"/>'
            )
            if last:
                lines += narrow.geoms(end, contype)
        if robot.capsules is not None:
            lines += _own_capsules(robot, robot.capsules, limb, j, points, narrow, contype)
        before = points[j]
    lines.append(toe_xml.format(place=numbers(points[-1] - points[-2])))
    return [*lines, "</body>" * robot.joint_count]


def thickness_of(robot: Robot) -> float:
    """Radius [m] of links that are straight; where they are not, of the thinnest near a toe."""
    radius = robot.limb_radius
    if robot.capsules is not None:
        last = robot.capsules.joint == robot.joint_count - 1
        radius = float(robot.capsules.radius[last].min())
    return max(radius, _THINNEST)


def _own_capsules(
    robot: Robot,
    capsules: MountedCapsules,
    limb: int,
    joint: int,
    points: Array,
    narrow: Narrow,
    contype: int,
) -> list[str]:
    """What a link touches with: its capsules, on the last link up to where it narrows."""
    lines = []
    own = zip(capsules.joint[limb], capsules.ends[limb], capsules.radius[limb], strict=True)
    seen = set()
    for link, (start, end), radius in own:
        if link != joint or (key := (tuple(start), tuple(end), radius)) in seen:
            continue  # limbs with fewer capsules have some twice
        seen.add(key)
        along = start - end
        length = float(np.linalg.norm(along))
        back = 0.0
        if joint == robot.joint_count - 1:
            toe = points[-1]
            if max(math.dist(start, toe), math.dist(end, toe)) + radius <= narrow.foot + _FOOT:
                continue  # the foot, which is the toe
            begins = narrow.length if narrow.foot == 0 else (radius - narrow.foot) / SLENDER
            back = max(begins - math.dist(end, toe), 0.0)
        if 0 < length <= back or length < back:
            continue
        tip = end + along * (back / length) if back > 0 else end
        size = max(float(radius), _THINNEST)
        place = np.stack([start, tip]) - points[joint]
        shape = f'type="capsule" fromto="{numbers(place)}"'
        if float(np.linalg.norm(start - tip)) < _POINT:
            shape = f'type="sphere" pos="{numbers(place[0])}"'
        lines.append(
            f'<geom {shape} size="{size:.6g}" mass="0" material="link" contype="{contype}" '
            'conaffinity="0"/>'
        )
    return lines
