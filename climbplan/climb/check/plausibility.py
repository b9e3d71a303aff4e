"""Warnings of implausible data: values and deflections far from any climbing robot.

`verification/plausibility.py` gives the reasons for these warnings.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.joint_units import format_joint_position, stiffness_unit, torque_unit
from climbplan.robots.model import Robot
from climbplan.terrain.surfaces import Region
from climbplan.verification.plausibility import (
    warn_of_force,
    warn_of_friction,
    warn_of_gravity,
)

# A joint at the limb's full length holds a walking robot once or twice, a climber less than once.
MAX_TORQUE_RATIO = 10.0
# Commands lead a compliant joint by what its load bends it (24 degrees at most on the shipped
# climbs, which puts toes a third of a limb off): no joint is a linear spring much farther.
MAX_LEAD = np.deg2rad(45.0)  # [rad]
MAX_LEAD_RATIO = 0.5  # of the limb's length, by which commands put its toe into the wall or off it
# A body that sags or tilts by more is no longer near its pose, which the linear model asks for.
MAX_DEFLECTION_RATIO = 0.15  # of the largest reach
MAX_DEFLECTION_ANGLE = np.deg2rad(15.0)  # [rad]
# A joint under its share of the weight at the limb's length: bent by more than a radian, it folds;
# stiffer than a ten-thousandth of a degree, a position loop does not get.
MAX_JOINT_DEFLECTION = 1.0  # [rad]
MIN_JOINT_DEFLECTION = 2e-6  # [rad]
MAX_REACH = 3.0  # [m] of one limb
DENSITY_RANGE = (5.0, 8000.0)  # [kg/m^3] of the body's box: foam, and steel throughout
MAX_SPEED = 60.0  # [rad/s] some 570 turns a minute, behind a gear that carries weight


def find_implausible_values(plan: ClimbPlan) -> tuple[str, ...]:
    """Return warnings about robot, terrain, forces and commands of a climb or transition."""
    robot = plan.robot
    links = find_massless_links(plan.robot_texts.urdf)
    return (
        *_warn_of_robot(robot),
        *links,
        *_warn_of_terrain(plan),
        *_warn_of_loads(plan),
        *_warn_of_deflections(plan),
    )


def _warn_of_robot(robot: Robot) -> Iterator[str]:
    """Yield warnings of implausible robot data."""
    yield from warn_of_gravity(robot.gravity)
    has_joint = robot.has_joint
    length = np.where(has_joint, robot.longest_links, 0.0).sum(axis=1)
    arm = float(length.max(initial=0.0))
    # N m at a joint that holds all of the weight at full length, N at one that slides
    holding_torque = robot.weight * np.where(robot.slides, 1.0, arm)
    torque = np.where(has_joint, robot.max_torque, 0.0)
    torque_ratio = np.where(holding_torque > 0, torque / np.maximum(holding_torque, 1e-300), 0.0)
    limb, joint = (
        int(i) for i in np.unravel_index(int(np.argmax(torque_ratio)), torque_ratio.shape)
    )
    if torque_ratio[limb, joint] > MAX_TORQUE_RATIO:
        unit = torque_unit(robot, limb, joint)
        yield (
            f"{'force' if robot.slides[limb, joint] else 'torque'} limit {torque[limb, joint]:g} "
            f"{unit} at {_name_joint(robot, limb, joint)}: "
            f"{torque_ratio[limb, joint]:.0f} times what holds the whole "
            f"robot ({robot.mass:g} kg) at the end of the limb"
        )
    stiffness = np.where(has_joint, robot.joint_stiffness, np.nan)
    if robot.weight * arm > 0:
        deflection = holding_torque / robot.limb_count / stiffness
        relative_deflection = deflection / robot.joint_unit
        limb, joint = (
            int(i)
            for i in np.unravel_index(int(np.nanargmax(relative_deflection)), deflection.shape)
        )
        if relative_deflection[limb, joint] > MAX_JOINT_DEFLECTION:
            yield (
                f"{_describe_stiffness(robot, limb, joint)}: "
                f"a limb's share of the weight at its end would bend it "
                f"by {_format_deflection(robot, limb, joint, deflection[limb, joint], '.0f')}"
            )
        limb, joint = (
            int(i)
            for i in np.unravel_index(int(np.nanargmin(relative_deflection)), deflection.shape)
        )
        if relative_deflection[limb, joint] < MIN_JOINT_DEFLECTION:
            yield (
                f"{_describe_stiffness(robot, limb, joint)}: "
                "a limb's share of the weight at its end bends it "
                f"by {_format_deflection(robot, limb, joint, deflection[limb, joint], '.1g')}, "
                "as no motor's control "
                "does"
            )
    volume = float(np.prod(np.ptp(robot.body_hull, axis=0)))
    density = robot.mass / volume if volume > 0 else np.inf
    if not DENSITY_RANGE[0] <= density <= DENSITY_RANGE[1]:
        yield (
            f"mass {robot.mass:g} kg in a body of {1e3 * volume:.3g} litres: {density:.3g} kg/m^3 "
            "(water has 1000)"
        )
    if arm > MAX_REACH:
        yield f"limbs of {arm:.1f} m: lengths are in metres"
    speed = np.where(has_joint & ~robot.slides, robot.max_joint_speed, 0.0)
    if speed.max() > MAX_SPEED:
        turns_per_minute = speed.max() * 30 / np.pi
        yield f"joint speed limit {speed.max():g} rad/s: {turns_per_minute:.0f} turns a minute"


def find_massless_links(urdf: str) -> Iterator[str]:
    """Yield a warning if most moving parts of a URDF's text have no mass.

    A part is a link that a joint moves with all that is fixed to it. Single frames without mass are
    usual. An empty text, of a robot without URDF, gives no warning.
    """
    if not urdf:
        return
    from climbplan.schema.robots.urdf.tree import parse_urdf
    from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

    try:
        tree = parse_urdf(urdf, Path("urdf"))
    except (UrdfFault, UrdfFaults):
        return  # `robot.spec` says what is wrong with it
    mass = tree.moving_mass
    massless = [name for name, link_mass in mass.items() if link_mass == 0]
    if 2 * len(massless) > len(mass):
        shown_names = ", ".join(massless[:3]) + (", ..." if len(massless) > 3 else "")
        count = f"{len(massless)} of {len(mass)}"
        yield f"{count} moving links of the URDF have no mass ({shown_names})"


def _warn_of_terrain(plan: ClimbPlan) -> Iterator[str]:
    """Yield warnings of implausible friction coefficients."""
    used_regions = np.unique(plan.rounds.region)
    for number in used_regions:
        surface = plan.terrain.surfaces[int(number)]
        # Grips hold by their spines; what their holds say of friction is told by the grip's model.
        if not (isinstance(surface, Region) and surface.hold is not None):
            yield from warn_of_friction(surface.name, surface.friction)


def _warn_of_loads(plan: ClimbPlan) -> Iterator[str]:
    """Yield a warning of implausibly large contact forces."""
    robot, instants = plan.robot, plan.instants
    size = np.linalg.norm(plan.forces.force, axis=-1)
    k, limb = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    external_force = float(np.linalg.norm(instants.external_wrench[:, :3], axis=1).max(initial=0.0))
    place = f" ({robot.limb_names[limb]}, {instants.label(k, robot.limb_names)})"
    yield from warn_of_force(float(size[k, limb]), robot.weight + external_force, place)


def _warn_of_deflections(plan: ClimbPlan) -> Iterator[str]:
    """Yield warnings of commands far from the joint angles and of large body deflections."""
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    lead = np.abs(forces.joint_command - instants.joint_angles)
    lead = np.where(robot.has_joint & instants.contact[..., None], lead, 0.0)
    relative_lead = lead / robot.joint_unit
    k, limb, joint = (int(i) for i in np.unravel_index(int(np.argmax(relative_lead)), lead.shape))
    if relative_lead[k, limb, joint] > MAX_LEAD:
        lead_text = _format_deflection(robot, limb, joint, lead[k, limb, joint], ".0f")
        yield (
            f"commands {lead_text} beyond the joint's angle "
            f"({_name_joint(robot, limb, joint)}, {instants.label(k, robot.limb_names)}): "
            "no joint is a spring that far"
        )
    length = np.where(robot.has_joint, robot.longest_links, 0.0).sum(axis=1)
    toe_lead = np.linalg.norm(forces.toe_command - instants.toes, axis=-1)
    toe_lead = np.where(instants.contact, toe_lead, 0.0)
    k, limb = (int(i) for i in np.unravel_index(int(np.argmax(toe_lead / length)), toe_lead.shape))
    if toe_lead[k, limb] > MAX_LEAD_RATIO * length[limb]:
        yield (
            f"commands that would put a toe {1e3 * toe_lead[k, limb]:.0f} mm off where it stands, "
            f"{100 * toe_lead[k, limb] / length[limb]:.0f} % of the limb "
            f"({robot.limb_names[limb]}, "
            f"{instants.label(k, robot.limb_names)})"
        )
    shift = float(np.linalg.norm(forces.com_deflection[:, :3], axis=1).max(initial=0.0))
    turn = float(np.linalg.norm(forces.com_deflection[:, 3:], axis=1).max(initial=0.0))
    if shift > MAX_DEFLECTION_RATIO * robot.reach or turn > MAX_DEFLECTION_ANGLE:
        yield (
            f"the body sags by {1e3 * shift:.0f} mm and {np.rad2deg(turn):.0f} degrees: far from "
            "small, which the linear model asks for"
        )


def _describe_stiffness(robot: Robot, limb: int, joint: int) -> str:
    """Describe the stiffness of a joint."""
    unit = stiffness_unit(robot, limb, joint)
    stiffness = robot.joint_stiffness[limb, joint]
    return f"joint stiffness {stiffness:g} {unit} at {_name_joint(robot, limb, joint)}"


def _format_deflection(robot: Robot, limb: int, joint: int, amount: float, digits: str) -> str:
    """Format the deflection of a joint with its unit."""
    return format_joint_position(robot, limb, joint, amount, digits).replace(" deg", " degrees")


def _name_joint(robot: Robot, limb: int, joint: int) -> str:
    """Return limb and joint as "RF femur"."""
    return f"{robot.limb_names[limb]} {robot.joint_name(limb, joint)}"
