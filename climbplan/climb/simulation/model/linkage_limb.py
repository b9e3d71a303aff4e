"""Build a leg of a yaw joint and a planar five-bar linkage, as nested MuJoCo bodies.

At zero angles both cranks and the last link point straight down in the leg's plane, x outward. The
coupler, which weighs nothing, is a tendon of constant length from crank A's end to the last link.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.model.chain_limb import name_motors
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.model import Robot
from climbplan.simulation.attributes import format_numbers

HINGE = "0 -1 0"  # turns what hangs down outward
_CRANK_MASS = 1e-3  # [kg] of crank A, which carries its motor's rotor inertia
_ELBOW_JOINT = 'armature="1e-4" damping="1e-3"'  # of the elbow


def build_linkage_limb(
    robot: Robot, limb: int, mass: float, joints_xml: Sequence[str], end_xml: str, contype: int
) -> list[str]:
    """Build the MJCF lines of one limb.

    Args:
        robot: The robot.
        limb: Index of the limb.
        mass: Mass of each link [kg].
        joints_xml: Element of each motor's joint, with {name} and {axis}.
        end_xml: Element at the last link's end, with {place}.
        contype: Collision class of links.
    """
    mechanism = robot.mechanism
    assert isinstance(mechanism, FiveBar)
    bar, radius = mechanism.linkage, max(robot.limb_radius, 0.005)
    half = robot.mount_yaw[limb] / 2
    orientation = format_numbers(np.array([np.cos(half), 0.0, 0.0, np.sin(half)]))
    yaw, first, second = name_motors(robot, limb)
    hip, elbow, end = (
        np.array([bar.offset, 0.0, bar.axis_f]),
        np.array([0.0, 0.0, -bar.crank_f]),
        np.array([0.0, 0.0, -bar.link]),
    )
    anchor = np.array([bar.held_across, 0.0, -bar.held_along])
    tip = np.array([0.0, 0.0, -bar.crank_a])

    def link(name: str, end: Array, weight: float, width_factor: float = 1.0) -> str:
        return (
            f'<geom name="{name}" type="capsule" fromto="0 0 0 {format_numbers(end)}"'
            f' size="{width_factor * radius:.6g}" mass="{weight:.9g}" material="link"'
            f' contype="{contype}" conaffinity="0"/>'
        )

    return [
        (
            f'<body name="{yaw}" pos="{format_numbers(robot.shoulder_body[limb])}" '
            f'quat="{orientation}">'
        ),
        joints_xml[0].format(name=yaw, axis="0 0 1"),
        link(yaw, hip, mass),
        f'<body name="{second}" pos="{bar.offset:.9g} 0 {bar.axis_a:.9g}">',
        joints_xml[2].format(name=second, axis=HINGE),
        link(second, tip, _CRANK_MASS, 0.5),
        f'<site name="tip{limb}" pos="{format_numbers(tip)}" size="0.001"/>',
        "</body>",
        f'<body name="{first}" pos="{format_numbers(hip)}">',
        joints_xml[1].format(name=first, axis=HINGE),
        link(first, elbow, mass),
        f'<body name="last{limb}" pos="{format_numbers(elbow)}">',
        f'<joint name="elbow{limb}" axis="{HINGE}" {_ELBOW_JOINT}/>',
        link(f"last{limb}", end, mass),
        f'<site name="held{limb}" pos="{format_numbers(anchor)}" size="0.001"/>',
        end_xml.format(place=format_numbers(end)),
        "</body></body></body>",
    ]


def build_couplers(robot: Robot) -> tuple[list[str], list[str]]:
    """Build tendons for all couplers, and the equality constraints of their lengths."""
    if not isinstance(robot.mechanism, FiveBar):
        return [], []
    bar = robot.mechanism.linkage
    # Ties are to lengths at zero angles, where the linkage does not close
    anchor = np.array([bar.held_across, bar.axis_f - bar.crank_f - bar.held_along])
    distance = float(np.linalg.norm(anchor - np.array([0.0, bar.axis_a - bar.crank_a])))
    tendons, ties = [], []
    for limb in range(robot.limb_count):
        tendons.append(
            f'<spatial name="coupler{limb}" width="{max(robot.limb_radius, 0.005) / 2:.6g}"'
            f' rgba="0.35 0.55 0.80 1"><site site="tip{limb}"/><site site="held{limb}"/></spatial>'
        )
        ties.append(
            f'<tendon tendon1="coupler{limb}" polycoef="{bar.coupler - distance:.9g} 0 0 0 0"'
            ' solref="0.002 1" solimp="0.9999 0.9999 0.001"/>'
        )
    return tendons, ties


def compute_elbow_angles(robot: Robot, angles: Array) -> Array:
    """Compute angles (N,) of the passive joints at motor angles (N, 3) [rad]."""
    mechanism = robot.mechanism
    assert isinstance(mechanism, FiveBar)
    return np.asarray(mechanism.plane(angles).tilt - angles[:, 1])
