"""Build a limb that is a serial chain of joints, as nested MuJoCo bodies.

At zero angles the frames of all links are parallel to the body's. Each joint is placed relative to
the one before, with its axis at zero angles.
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
from climbplan.simulation.attributes import format_numbers, write_inertial
from climbplan.terrain.raw_surface import SLENDER

_MIN_LINK_LENGTH = 0.01  # [m] of a link that is drawn and touches
_MIN_RADIUS = 0.005  # [m] radius of a link
_FOOT_TOLERANCE = 1e-3  # [m] by which the capsule of a foot may reach beyond its sphere
_MIN_AXIS_LENGTH = 1e-6  # [m] an axis this short is none
_TIE_SOLVER = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'
_DUMMY_MASS = 1e-4  # [kg] of a body where a limb has no joint
_ANY_AXIS = np.array([0.0, 0.0, 1.0])  # about which it does not turn
_NO_INERTIA = " ".join(["1e-07"] * 3)  # [kg m^2] principal inertia of a link without length


@dataclass(frozen=True)
class LimbTip:
    """The tapered end of a limb, which narrows to its toe."""

    length: float  # [m] of the last link that is not as thick as its others
    cone: tuple[tuple[float, float], ...]  # what of it touches: distances from the toe, radii [m]
    foot: float = 0.0  # [m] radius of the spherical foot that it narrows to

    def geoms(self, toe: Array, contype: int) -> list[str]:
        """Build capsules along the taper, each as thick as at its thinner end; toe: (3,)."""
        length = float(np.linalg.norm(toe))
        lines = []
        for (far_distance, _), (near_distance, radius) in itertools.pairwise(
            ((self.length, 0.0), *self.cone)
        ):
            if far_distance > 0.9 * length:
                continue
            ends = np.concatenate(
                [(1 - far_distance / length) * toe, (1 - near_distance / length) * toe]
            )
            lines.append(
                f'<geom type="capsule" fromto="{format_numbers(ends)}" size="{radius:.6g}" mass="0"'
                f' material="link" contype="{contype}" conaffinity="0"/>'
            )
        return lines


def require_chain(robot: Robot) -> SerialChain:
    """Return the serial chains of a robot; raise UsageError if it has none."""
    chain = robot.mechanism
    if not isinstance(chain, SerialChain):
        raise UsageError(f"`simulate` cannot build the limbs of {robot.name}")
    return chain


def build_joint_ties(robot: Robot) -> list[str]:
    """Build the equality constraints of missing joints, fixed at zero, and of joints that mimic.

    Arrays of joints are as wide as the longest limb. The first joints of a shorter limb are bodies
    of negligible mass at the place of its first real joint.
    """
    if robot.mechanism is None:
        return []
    mimics, ties = find_mimic_joints(robot), []
    for limb in range(robot.limb_count):
        names = name_motors(robot, limb)
        for joint in np.flatnonzero(~robot.has_joint[limb]):
            if mimics[limb, joint]:
                row = compute_drive(robot)[limb, joint]
                leader = int(np.argmax(np.abs(row)))
                ties.append(
                    f'<joint joint1="{names[joint]}" joint2="{names[leader]}" '
                    f'polycoef="0 {row[leader]:.12g} 0 0 0" {_TIE_SOLVER}/>'
                )
            else:
                ties.append(f'<joint joint1="{names[joint]}" polycoef="0 0 0 0 0" {_TIE_SOLVER}/>')
    return ties


def compute_drive(robot: Robot) -> Array:
    """Return the motion (N, J, J) of joints by angles: the identity unless joints mimic others."""
    if isinstance(robot.mechanism, SerialChain):
        return robot.mechanism.drives
    return np.broadcast_to(
        np.eye(robot.joint_count), (robot.limb_count, robot.joint_count, robot.joint_count)
    )


def find_mimic_joints(robot: Robot) -> BoolArray:
    """Find joints (N, J) that mimic others."""
    return np.asarray(np.diagonal(compute_drive(robot), axis1=-2, axis2=-1) == 0.0)


def name_motors(robot: Robot, limb: int) -> list[str]:
    """List the names of a limb's joints and motors in the model, from the body to the toe."""
    if robot.mechanism is None:
        return [f"{joint}{limb}" for joint in ("coxa", "femur", "tibia")]
    return [f"joint{j}limb{limb}" for j in range(robot.joint_count)]


def build_chain_limb(
    robot: Robot,
    limb: int,
    mass: float,
    joints_xml: Sequence[str],
    *,
    toe_xml: str,
    tip: LimbTip,
    contype: int,
    weights: LinkMasses | None = None,
) -> list[str]:
    """Build the MJCF lines of one limb.

    Args:
        robot: The robot.
        limb: Index of the limb.
        mass: Mass of each link [kg], if `weights` is None.
        joints_xml: Element of each joint, with {name} and {axis}.
        toe_xml: Element of the toe, with {place}.
        tip: The tapered end of the last link.
        contype: Collision class of links.
        weights: Masses of individual links.
    """
    chain = require_chain(robot)
    points = np.concatenate([chain.joint_zero[limb], chain.toe_zero[limb][None]])
    lines: list[str] = []
    shape_mass = mass if weights is None else 0.0
    for j, name in enumerate(name_motors(robot, limb)):
        offset, end = points[j] - (points[j - 1] if j else 0.0), points[j + 1] - points[j]
        lines += [
            f'<body name="{name}" pos="{format_numbers(offset)}">',
            joints_xml[j].format(name=name, axis=format_numbers(_find_axis(chain, limb, j))),
        ]
        length = float(np.linalg.norm(end))
        if weights is not None:
            link_name = f"the link moved by {chain.names[limb][j] or name}"
            link = weights.mass[limb, j], weights.middle[limb, j], weights.inertia[limb, j]
            lines.append(write_inertial(*link, link_name))
        elif length < _MIN_LINK_LENGTH:
            link_mass = mass if chain.names[limb][j] else _DUMMY_MASS
            lines.append(
                f'<inertial pos="0 0 0" mass="{link_mass:.9g}" diaginertia="{_NO_INERTIA}"/>'
            )
        if length >= _MIN_LINK_LENGTH:
            is_last = j == robot.joint_count - 1
            shown_fraction = max(length - tip.length, 0.1 * length) / length if is_last else 1.0
            collision_class = contype if robot.capsules is None else 0
            lines.append(
                f'<geom name="{name}" type="capsule" '
                f'fromto="0 0 0 {format_numbers(shown_fraction * end)}" '
                f'size="{compute_link_radius(robot):.6g}" mass="{shape_mass:.9g}" material="link" '
                f'contype="{collision_class}" conaffinity="0"/>'
            )
            if is_last:
                lines += tip.geoms(end, contype)
        if robot.capsules is not None:
            lines += _build_capsules(
                robot, robot.capsules, limb, j, points=points, tip=tip, contype=contype
            )
    lines.append(toe_xml.format(place=format_numbers(points[-1] - points[-2])))
    return [*lines, "</body>" * robot.joint_count]


def _find_axis(chain: SerialChain, limb: int, joint: int) -> Array:
    """Find the unit axis (3,) about which a joint rotates, or along which it slides."""
    if chain.slide_zero is not None and chain.sliding[limb, joint]:
        return chain.slide_zero[limb, joint]
    return chain.axis_zero[limb, joint] if chain.names[limb][joint] else _ANY_AXIS


def compute_link_radius(robot: Robot) -> float:
    """Compute the radius of links [m]; with capsules, of the thinnest on last links."""
    radius = robot.limb_radius
    if robot.capsules is not None:
        is_last_link = robot.capsules.joint == robot.joint_count - 1
        radius = float(robot.capsules.radius[is_last_link].min())
    return max(radius, _MIN_RADIUS)


def _build_capsules(
    robot: Robot,
    capsules: MountedCapsules,
    limb: int,
    joint: int,
    *,
    points: Array,
    tip: LimbTip,
    contype: int,
) -> list[str]:
    """Build the collision capsules of a link; those of the last link end where it narrows."""
    lines = []
    capsules_of_limb = zip(
        capsules.joint[limb], capsules.ends[limb], capsules.radius[limb], strict=True
    )
    finished = set()
    for link, (start, end), radius in capsules_of_limb:
        if link != joint or (key := (tuple(start), tuple(end), radius)) in finished:
            continue  # limbs with fewer capsules have some twice
        finished.add(key)
        axis = start - end
        length = float(np.linalg.norm(axis))
        setback = 0.0
        if joint == robot.joint_count - 1:
            toe = points[-1]
            if (
                max(math.dist(start, toe), math.dist(end, toe)) + radius
                <= tip.foot + _FOOT_TOLERANCE
            ):
                continue  # the foot, which is the toe
            tip_start = tip.length if tip.foot == 0 else (radius - tip.foot) / SLENDER
            setback = max(tip_start - math.dist(end, toe), 0.0)
        if 0 < length <= setback or length < setback:
            continue
        tip_point = end + axis * (setback / length) if setback > 0 else end
        shown_radius = max(float(radius), _MIN_RADIUS)
        ends = np.stack([start, tip_point]) - points[joint]
        shape = f'type="capsule" fromto="{format_numbers(ends)}"'
        if float(np.linalg.norm(start - tip_point)) < _MIN_AXIS_LENGTH:
            shape = f'type="sphere" pos="{format_numbers(ends[0])}"'
        lines.append(
            f'<geom {shape} size="{shown_radius:.6g}" mass="0" material="link" contype="{contype}" '
            'conaffinity="0"/>'
        )
    return lines
