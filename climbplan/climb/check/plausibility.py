"""What no climbing robot has: data and deflections far from anything built.

`verification/plausibility.py` says why they are warned of.
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
    implausible_force,
    implausible_friction,
    implausible_gravity,
)

# A joint at the limb's full length holds a walking robot once or twice, a climber less than once.
TORQUE_RATIO = 10.0
# Commands lead a compliant joint by what its load bends it (24 degrees at most on the shipped
# climbs, which puts toes a third of a limb off): no joint is a linear spring much farther.
LEAD = np.deg2rad(45.0)  # [rad]
LEAD_SHARE = 0.5  # of the limb's length, by which commands put its toe into the wall or off it
# A body that sags or tilts by more is no longer near its pose, which the linear model asks for.
SAG_SHARE = 0.15  # of the largest reach
SAG_TURN = np.deg2rad(15.0)  # [rad]
# A joint under its share of the weight at the limb's length: bent by more than a radian, it folds;
# stiffer than a ten-thousandth of a degree, a position loop does not get.
FOLDS = 1.0  # [rad]
RIGID = 2e-6  # [rad]
REACH = 3.0  # [m] of one limb
DENSITY = (5.0, 8000.0)  # [kg/m^3] of the body's box: foam, and steel throughout
SPEED = 60.0  # [rad/s] some 570 turns a minute, behind a gear that carries weight


def implausible_climb(plan: ClimbPlan) -> tuple[str, ...]:
    """Warnings about robot, terrain, forces and commands of a climb or transition."""
    robot = plan.robot
    links = massless_links(plan.robot_texts.urdf)
    return (*_robot(robot), *links, *_terrain(plan), *_loads(plan), *_deflections(plan))


def _robot(robot: Robot) -> Iterator[str]:
    yield from implausible_gravity(robot.gravity)
    has = robot.has_joint
    length = np.where(has, robot.longest_links, 0.0).sum(axis=1)
    arm = float(length.max(initial=0.0))
    # N m at a joint that holds all of the weight at full length, N at one that slides
    needed = robot.weight * np.where(robot.slides, 1.0, arm)
    torque = np.where(has, robot.max_torque, 0.0)
    over = np.where(needed > 0, torque / np.maximum(needed, 1e-300), 0.0)
    limb, joint = (int(i) for i in np.unravel_index(int(np.argmax(over)), over.shape))
    if over[limb, joint] > TORQUE_RATIO:
        unit = torque_unit(robot, limb, joint)
        yield (
            f"{'force' if robot.slides[limb, joint] else 'torque'} limit {torque[limb, joint]:g} "
            f"{unit} at {_name(robot, limb, joint)}: {over[limb, joint]:.0f} times what holds the "
            f"whole robot ({robot.mass:g} kg) at the end of the limb"
        )
    stiffness = np.where(has, robot.joint_stiffness, np.nan)
    if robot.weight * arm > 0:
        bend = needed / robot.limb_count / stiffness
        share = bend / robot.joint_unit
        limb, joint = (int(i) for i in np.unravel_index(int(np.nanargmax(share)), bend.shape))
        if share[limb, joint] > FOLDS:
            yield (
                f"{_stiff(robot, limb, joint)}: a limb's share of the weight at its end would bend "
                f"it by {_bent(robot, limb, joint, bend[limb, joint], '.0f')}"
            )
        limb, joint = (int(i) for i in np.unravel_index(int(np.nanargmin(share)), bend.shape))
        if share[limb, joint] < RIGID:
            yield (
                f"{_stiff(robot, limb, joint)}: a limb's share of the weight at its end bends it "
                f"by {_bent(robot, limb, joint, bend[limb, joint], '.1g')}, as no motor's control "
                "does"
            )
    volume = float(np.prod(np.ptp(robot.body_hull, axis=0)))
    density = robot.mass / volume if volume > 0 else np.inf
    if not DENSITY[0] <= density <= DENSITY[1]:
        yield (
            f"mass {robot.mass:g} kg in a body of {1e3 * volume:.3g} litres: {density:.3g} kg/m^3 "
            "(water has 1000)"
        )
    if arm > REACH:
        yield f"limbs of {arm:.1f} m: lengths are in metres"
    speed = np.where(has & ~robot.slides, robot.max_joint_speed, 0.0)
    if speed.max() > SPEED:
        turns = speed.max() * 30 / np.pi
        yield f"joint speed limit {speed.max():g} rad/s: {turns:.0f} turns a minute"


def massless_links(urdf: str) -> Iterator[str]:
    """Moving parts of a URDF's text that have no mass, where most of them have none.

    A part is a link that a joint moves with all that is fixed to it: single frames without mass
    are usual. An empty text, of a robot that is from no URDF, has none.
    """
    if not urdf:
        return
    from climbplan.schema.robots.urdf.tree import urdf_of_text
    from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

    try:
        tree = urdf_of_text(urdf, Path("urdf"))
    except (UrdfFault, UrdfFaults):
        return  # `robot.spec` says what is wrong with it
    mass = tree.moving_mass
    empty = [name for name, own in mass.items() if own == 0]
    if 2 * len(empty) > len(mass):
        shown = ", ".join(empty[:3]) + (", ..." if len(empty) > 3 else "")
        yield f"{len(empty)} of {len(mass)} moving links of the URDF have no mass ({shown})"


def _terrain(plan: ClimbPlan) -> Iterator[str]:
    used = np.unique(plan.rounds.region)
    for number in used:
        surface = plan.terrain.surfaces[int(number)]
        # Grips hold by their spines; what their holds say of friction is told by the grip's model.
        if not (isinstance(surface, Region) and surface.hold is not None):
            yield from implausible_friction(surface.name, surface.friction)


def _loads(plan: ClimbPlan) -> Iterator[str]:
    robot, instants = plan.robot, plan.instants
    size = np.linalg.norm(plan.forces.force, axis=-1)
    k, limb = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    extra = float(np.linalg.norm(instants.external_wrench[:, :3], axis=1).max(initial=0.0))
    where = f" ({robot.limb_names[limb]}, {instants.label(k, robot.limb_names)})"
    yield from implausible_force(float(size[k, limb]), robot.weight + extra, where)


def _deflections(plan: ClimbPlan) -> Iterator[str]:
    """What the loads do to the robot: commands that lead their joints, the body's sag."""
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    lead = np.abs(forces.joint_command - instants.joint_angles)
    lead = np.where(robot.has_joint & instants.contact[..., None], lead, 0.0)
    share = lead / robot.joint_unit
    k, limb, joint = (int(i) for i in np.unravel_index(int(np.argmax(share)), lead.shape))
    if share[k, limb, joint] > LEAD:
        ahead = _bent(robot, limb, joint, lead[k, limb, joint], ".0f")
        yield (
            f"commands {ahead} beyond the joint's angle "
            f"({_name(robot, limb, joint)}, {instants.label(k, robot.limb_names)}): no joint is a "
            "spring that far"
        )
    length = np.where(robot.has_joint, robot.longest_links, 0.0).sum(axis=1)
    off = np.linalg.norm(forces.toe_command - instants.toes, axis=-1)
    off = np.where(instants.contact, off, 0.0)
    k, limb = (int(i) for i in np.unravel_index(int(np.argmax(off / length)), off.shape))
    if off[k, limb] > LEAD_SHARE * length[limb]:
        yield (
            f"commands that would put a toe {1e3 * off[k, limb]:.0f} mm off where it stands, "
            f"{100 * off[k, limb] / length[limb]:.0f} % of the limb ({robot.limb_names[limb]}, "
            f"{instants.label(k, robot.limb_names)})"
        )
    shift = float(np.linalg.norm(forces.com_deflection[:, :3], axis=1).max(initial=0.0))
    turn = float(np.linalg.norm(forces.com_deflection[:, 3:], axis=1).max(initial=0.0))
    if shift > SAG_SHARE * robot.reach or turn > SAG_TURN:
        yield (
            f"the body sags by {1e3 * shift:.0f} mm and {np.rad2deg(turn):.0f} degrees: far from "
            "small, which the linear model asks for"
        )


def _stiff(robot: Robot, limb: int, joint: int) -> str:
    unit = stiffness_unit(robot, limb, joint)
    stiffness = robot.joint_stiffness[limb, joint]
    return f"joint stiffness {stiffness:g} {unit} at {_name(robot, limb, joint)}"


def _bent(robot: Robot, limb: int, joint: int, amount: float, digits: str) -> str:
    return format_joint_position(robot, limb, joint, amount, digits).replace(" deg", " degrees")


def _name(robot: Robot, limb: int, joint: int) -> str:
    return f"{robot.limb_names[limb]} {robot.joint_name(limb, joint)}"
