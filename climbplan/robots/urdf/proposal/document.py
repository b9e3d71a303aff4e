"""A proposed robot as a file that people read and change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot, dynamics_of
from climbplan.robots.urdf.proposal.settled import SHARE, Proposal
from climbplan.robots.urdf.proposal.yaml_words import mapping, scalar


def robot_document(proposal: Proposal, urdf: str, pages: str) -> str:
    """The robot file; urdf: its path as written there; pages: file names of the specs."""
    p, draft, robot = proposal, proposal.draft, proposal.robot
    motors = p.motors
    odd = [f"# IMPLAUSIBLE  {text}" for text in p.odd]
    assumed = [f"# ASSUMED  {text}" for text in p.assumed]
    stands = -robot.stance_body[:, 2].mean()
    lines = [
        f"# {robot.name}, proposed from its URDF by `climbplan new robot`; {pages} use it.",
        "# Lengths, axes, masses, joint bounds, torque and speed limits are the URDF's. What it",
        "# cannot say is proposed here, with the reason: look at ASSUMED and IMPLAUSIBLE first.",
        *odd,
        *assumed,
        "kind: robot",
        f"urdf: {scalar(urdf)}",
        f"base: {scalar(draft.base)}  # the body; its frame and toes are links of it",
        f"forward: {draft.forward}  # axis of the base that points forward",
        f"up: {draft.up}  # axis of the base that points up",
    ]
    if draft.packages:
        lines.append(f"packages: {json.dumps(draft.packages)}")
    lines += [
        f"# mass: {robot.mass:.4g}  # [kg] the sum over its links",
        "",
        "# [N m/rad] of joints under position control. ASSUMED: the P gain with which a joint",
        "# gives its whole torque limit 0.25 rad (14 deg) off its command, or off what it turns in",
        "# 10 ms if it is so fast; at least 4 times weight times reach, or the body on its",
        "# springs buckles.",
        "# Measure it: `climbplan fit-stiffness`.",
        f"joint_stiffness: {motors.stiffness:g}",
        f"structural_compliance_share: {SHARE:g}  # ASSUMED: part of the give that is in links",
        *_rotors(robot),
    ]
    lines += [
        "",
        "# ASSUMED, standard deviations (play: the most there is) of the worlds in which plans are",
        "# judged.",
        "uncertainty: {mass: 0.05, joint_stiffness: 0.1, backlash_deg: 0.2}",
    ]
    if draft.joints:
        lines += ["", "# Where the URDF says nothing that a motor can be, or joints are not alike"]
        lines.append("joints:")
        lines += [f"  {scalar(n)}: {mapping(own)}" for n, own in draft.joints.items()]
    if draft.locked:
        lines += [
            "",
            "# [deg] Held there: joints that legs share, or beyond the seventh of a leg, or of an",
            "# arm that would be in the way at zero",
        ]
        lines.append(f"locked: {mapping(draft.locked)}")
    lines.append("")
    if p.body_box is not None:
        size = " x ".join(f"{v:.3f}" for v in np.ptp(p.body_box[0:2], axis=0))
        lines.append(f"# body_half_size: [0.1, 0.2, 0.05]  # [m]; left out: the base's, {size} m")
    else:
        half = ", ".join(f"{v:g}" for v in p.half_size or ())
        lines.append(f"body_half_size: [{half}]  # [m] ASSUMED: round the first joints")
    holding = "three legs" if robot.sole is None else "one leg"
    use = f"at most {100 * p.posture.use:.0f} % of a torque limit on {holding}"
    lines += [
        *_links(robot),
        *_feet(robot),
        f"# workspace: {{stance_radius: {robot.stance_radius:g}}}  # [m] sampled about the stance",
        "",
        f"# Legs in leg order. Standing: body {stands:.3f} m above its toes, with most room about",
        f"# them ({1e3 * robot.stance_radius:.0f} mm) and {use}.",
        "legs:",
    ]
    for name, toe in zip(robot.limb_names, p.toes, strict=True):
        own = draft.legs[name]
        lines.append(f"  {scalar(name)}:")
        lines.append(f"    toe: {scalar(toe.link)}  # {toe.why}")
        if any(toe.offset):
            lines.append(f"    toe_offset: {json.dumps(list(toe.offset))}  # [m] in its frame")
        lines.append(f"    posture_deg: {mapping(own['posture_deg'])}")
    return "\n".join(lines) + "\n"


def _rotors(robot: Robot) -> list[str]:
    """What `simulate` takes joints to resist motion with, as comments."""
    own = dynamics_of(robot)
    inertia, gain = own.rotor_inertia[robot.has_joint], own.damping[robot.has_joint]
    return [
        "# For `simulate`: rotors behind gears and derivative gains, of all joints that turn. Left",
        "# out: 0.006 s * torque limit / speed limit, and the gain that damps that critically.",
        f"# joint_rotor_inertia: {np.median(inertia):.2g}  # [kg m^2] {_span(inertia)}",
        f"# joint_damping: {np.median(gain):.2g}  # [N m s/rad] {_span(gain)}",
    ]


def _span(values: Array) -> str:
    """ASSUMED, and from where to where."""
    low, high = f"{values.min():.2g}", f"{values.max():.2g}"
    return f"ASSUMED {low}" if low == high else f"ASSUMED {low} to {high}"


def _feet(robot: Robot) -> list[str]:
    """Feet of finite size."""
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


def _links(robot: Robot) -> list[str]:
    """How thick the links are: stated where the URDF does not say, else told."""
    capsules = robot.capsules
    if capsules is None:
        return [f"limb_radius: {robot.limb_radius:g}  # [m] ASSUMED: no collision geometry is read"]
    names = robot.limbs.joint_names[0]
    thick = {
        name: round(float(capsules.radius[0][capsules.joint[0] == joint].max()), 4)
        for joint, name in enumerate(names)
        if name and (capsules.joint[0] == joint).any()
    }
    return [
        "# Links are as thick as their collision geometry: each piece of it has a capsule of its",
        "# own. `limb_radii` says otherwise: the radius [m] of a link that is straight from its",
        f"# joint to the next. The thickest, of {robot.limb_names[0]}:",
        f"# limb_radii: {mapping(thick)}",
    ]


def paths(proposal: Proposal, directory: Path) -> str:
    """The URDF's path as a robot file in `directory` names it: relative where it is near."""
    urdf = proposal.draft.urdf
    here = directory.resolve()
    for up, parent in enumerate((here, *list(here.parents)[:2])):
        if urdf.is_relative_to(parent) and parent != Path(parent.anchor):
            return "/".join([".."] * up + [urdf.relative_to(parent).as_posix()])
    return str(urdf)
