"""Format a proposed robot as a robot file that people read and change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot, dynamics_of
from climbplan.robots.urdf.proposal.prepared_robot import STRUCTURAL_COMPLIANCE_SHARE, RobotProposal
from climbplan.robots.urdf.proposal.yaml_format import format_mapping, format_scalar


def format_robot_document(proposal: RobotProposal, urdf: str, pages: str) -> str:
    """Return the robot file.

    Args:
        proposal: The robot.
        urdf: Path of the URDF, as written in the file.
        pages: File names of the specs that use it.
    """
    lines = [
        *_format_header(proposal, urdf, pages),
        *_format_joints(proposal),
        "",
        *_format_body(proposal),
        *_format_legs(proposal),
    ]
    return "\n".join(lines) + "\n"


def _format_header(proposal: RobotProposal, urdf: str, pages: str) -> list[str]:
    """Return the notes for readers, and the lines on the URDF and the axes of its base."""
    draft = proposal.draft
    lines = [
        (
            f"# {proposal.robot.name}, proposed from its URDF by `climbplan new robot`; {pages} "
            "use it."
        ),
        "# Lengths, axes, masses, joint bounds, torque and speed limits are the URDF's. What it",
        "# cannot say is proposed here, with the reason: look at ASSUMED and IMPLAUSIBLE first.",
        *[f"# IMPLAUSIBLE  {text}" for text in proposal.implausible],
        *[f"# ASSUMED  {text}" for text in proposal.assumptions],
        "kind: robot",
        f"urdf: {format_scalar(urdf)}",
        f"base: {format_scalar(draft.base)}  # the body; its frame and toes are links of it",
        f"forward: {draft.forward}  # axis of the base that points forward",
        f"up: {draft.up}  # axis of the base that points up",
    ]
    if draft.missing_meshes:
        lines.append("missing_meshes: ignore  # shapes of meshes without a file are left out")
    if draft.packages:
        lines.append(f"packages: {json.dumps(draft.packages)}")
    return lines


def _format_joints(proposal: RobotProposal) -> list[str]:
    """Return the lines on mass, stiffness, motors and locked joints."""
    draft, robot = proposal.draft, proposal.robot
    lines = [
        f"# mass: {robot.mass:.4g}  # [kg] the sum over its links",
        "",
        "# [N m/rad] of joints under position control. ASSUMED: the P gain with which a joint",
        "# reaches its torque limit 0.25 rad (14 deg) off its command, or off its rotation within",
        "# 10 ms if it is so fast; at least 4 times weight times reach, or the body on its",
        "# springs buckles.",
        "# Measure it: `climbplan fit-stiffness`.",
        f"joint_stiffness: {proposal.motors.stiffness:g}",
        (
            f"structural_compliance_share: {STRUCTURAL_COMPLIANCE_SHARE:g}"
            "  # ASSUMED: share of the compliance that is in links"
        ),
        *_format_rotors(robot),
        "",
        "# ASSUMED: uncertainties with which plans are simulated: standard deviations, and largest",
        "# backlash.",
        "uncertainty: {mass: 0.05, joint_stiffness: 0.1, backlash_deg: 0.2}",
    ]
    if draft.joints:
        lines += ["", "# Joints whose URDF data no motor can have, or that differ from the others"]
        lines.append("joints:")
        lines += [
            f"  {format_scalar(n)}: {format_mapping(values)}" for n, values in draft.joints.items()
        ]
    if draft.locked:
        lines += [
            "",
            "# [deg] Locked joints: shared by legs, beyond the seventh of a leg, or of an arm that",
            "# would be in the way at zero",
        ]
        lines.append(f"locked: {format_mapping(draft.locked)}")
    return lines


def _format_body(proposal: RobotProposal) -> list[str]:
    """Return the lines on the size of the body, its links, its feet and its workspace."""
    robot = proposal.robot
    if proposal.body_box is not None:
        size = " x ".join(f"{v:.3f}" for v in np.ptp(proposal.body_box[0:2], axis=0))
        body = f"# body_half_size: [0.1, 0.2, 0.05]  # [m]; left out: the base's, {size} m"
    else:
        half_size = ", ".join(f"{v:g}" for v in proposal.half_size or ())
        body = f"body_half_size: [{half_size}]  # [m] ASSUMED: round the first joints"
    return [
        body,
        *_format_link_radii(robot),
        *_format_foot(robot),
        f"# workspace: {{stance_radius: {robot.stance_radius:g}}}  # [m] sampled about the stance",
        "",
    ]


def _format_legs(proposal: RobotProposal) -> list[str]:
    """Return the section of the legs: toes and standing posture."""
    robot = proposal.robot
    height = -robot.stance_body[:, 2].mean()
    supporting = "three legs" if robot.sole is None else "one leg"
    percent = f"{100 * proposal.posture.utilisation:.0f} %"
    lines = [
        f"# Legs in leg order. Standing: body {height:.3f} m above its toes, with the most reach",
        (
            f"# about them ({1e3 * robot.stance_radius:.0f} mm) and at most {percent} of a torque "
            f"limit on {supporting}."
        ),
        "legs:",
    ]
    for name, toe in zip(robot.limb_names, proposal.toes, strict=True):
        lines.append(f"  {format_scalar(name)}:")
        lines.append(f"    toe: {format_scalar(toe.link)}  # {toe.reason}")
        if any(toe.offset):
            lines.append(f"    toe_offset: {json.dumps(list(toe.offset))}  # [m] in its frame")
        posture = proposal.draft.legs[name]["posture_deg"]
        lines.append(f"    posture_deg: {format_mapping(posture)}")
    return lines


def _format_rotors(robot: Robot) -> list[str]:
    """Return comments on the rotor inertia and damping that `simulate` assumes."""
    dynamics = dynamics_of(robot)
    inertia, gain = dynamics.rotor_inertia[robot.has_joint], dynamics.damping[robot.has_joint]
    return [
        "# For `simulate`: rotors behind gears and derivative gains, of all joints that turn. Left",
        "# out: 0.006 s * torque limit / speed limit, and the gain that damps that critically.",
        (
            f"# joint_rotor_inertia: {np.median(inertia):.2g}"
            f"  # [kg m^2] {_format_assumed_range(inertia)}"
        ),
        f"# joint_damping: {np.median(gain):.2g}  # [N m s/rad] {_format_assumed_range(gain)}",
    ]


def _format_assumed_range(values: Array) -> str:
    """Return the range of assumed values."""
    low, high = f"{values.min():.2g}", f"{values.max():.2g}"
    return f"ASSUMED {low}" if low == high else f"ASSUMED {low} to {high}"


def _format_foot(robot: Robot) -> list[str]:
    """Return the lines on feet of finite size; none for points."""
    if robot.foot is None:
        return []
    if (sole := robot.sole) is not None:
        return [
            "# Flat feet, by the collision geometry of their links: toes are the middles of soles.",
            f"foot: {{length: {sole.length:g}, width: {sole.width:g}}}  # [m]",
        ]
    return [
        "# Spherical feet, by the collision geometry of their links: toes are their centres.",
        f"foot: {{radius: {robot.foot.radius:g}}}  # [m]",
    ]


def _format_link_radii(robot: Robot) -> list[str]:
    """Return the lines on how thick links are: assumed, or a comment on the collision geometry."""
    capsules = robot.capsules
    if capsules is None:
        return [f"limb_radius: {robot.limb_radius:g}  # [m] ASSUMED: no collision geometry is read"]
    names = robot.limbs.joint_names[0]
    radii = {
        name: round(float(capsules.radius[0][capsules.joint[0] == joint].max()), 4)
        for joint, name in enumerate(names)
        if name and (capsules.joint[0] == joint).any()
    }
    return [
        "# Links are as thick as their collision geometry: each piece of it has a capsule of its",
        "# own. `limb_radii` says otherwise: the radius [m] of a link that is straight from its",
        f"# joint to the next. The thickest, of {robot.limb_names[0]}:",
        f"# limb_radii: {format_mapping(radii)}",
    ]


def format_urdf_path(proposal: RobotProposal, directory: Path) -> str:
    """Return the URDF's path as a robot file in `directory` names it: relative where it is near."""
    urdf = proposal.draft.urdf
    folder = directory.resolve()
    for up, parent in enumerate((folder, *list(folder.parents)[:2])):
        if urdf.is_relative_to(parent) and parent != Path(parent.anchor):
            return "/".join([".."] * up + [urdf.relative_to(parent).as_posix()])
    return str(urdf)
