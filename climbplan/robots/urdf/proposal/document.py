"""A proposal as files that people read and change: the robot's, and two specs that use it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.proposing import SAFETY, SHARE, WALLS, Proposal

_FRICTION = 0.8  # rubber on a floor
_STEP = 0.35  # of the ball about its stance, that a toe steps in a round on ground
_RISE = 0.3  # and between walls
_LONGEST_STEP = 0.08  # [m]
_SHIFT = 0.6  # of the level distance of a toe from the body, that it may shift at most
_LIFT = 0.25  # of the ball, that a toe is lifted
_ROUNDS = 2
_NO_SHIFT = 1e-3  # [m]
_FAR = 3.0  # [m] of ground and walls beyond the robot


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
        f"urdf: {_text(urdf)}",
        f"base: {_text(draft.base)}  # the body; its frame and those of toes are links of the URDF",
        f"forward: {draft.forward}  # axis of the base that points forward; its z is up",
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
    ]
    if draft.joints:
        lines += ["", "# Where the URDF says nothing that a motor can be, or joints are not alike"]
        lines.append("joints:")
        lines += [f"  {_text(n)}: {_mapping(own)}" for n, own in draft.joints.items()]
    if draft.locked:
        lines += ["", "# [deg] Held there: joints that legs share, or beyond the seventh of a leg"]
        lines.append(f"locked: {_mapping(draft.locked)}")
    lines.append("")
    if p.body_box is not None:
        size = " x ".join(f"{v:.3f}" for v in np.ptp(p.body_box[0:2], axis=0))
        lines.append(f"# body_half_size: [0.1, 0.2, 0.05]  # [m]; left out: the base's, {size} m")
    else:
        half = ", ".join(f"{v:g}" for v in p.half_size or ())
        lines.append(f"body_half_size: [{half}]  # [m] ASSUMED: round the first joints")
    use = f"at most {100 * p.posture.use:.0f} % of a torque limit on three legs"
    lines += [
        *_links(robot),
        f"# workspace: {{stance_radius: {robot.stance_radius:g}}}  # [m] sampled about the stance",
        "",
        f"# Legs in leg order. Standing: body {stands:.3f} m above its toes, with most room about",
        f"# them ({1e3 * robot.stance_radius:.0f} mm) and {use}.",
        "legs:",
    ]
    for name, toe in zip(robot.limb_names, p.toes, strict=True):
        own = draft.legs[name]
        lines.append(f"  {_text(name)}:")
        lines.append(f"    toe: {_text(toe.link)}  # {toe.why}")
        if any(toe.offset):
            lines.append(f"    toe_offset: {json.dumps(list(toe.offset))}  # [m] in its frame")
        lines.append(f"    posture_deg: {_mapping(own['posture_deg'])}")
    return "\n".join(lines) + "\n"


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
        f"# limb_radii: {_mapping(thick)}",
    ]


def ground_document(proposal: Proposal, robot_file: str) -> str:
    """A few steps over flat ground."""
    robot = proposal.robot
    ball = robot.stance_radius
    step = min(_STEP * ball, _LONGEST_STEP)
    height = float(-robot.stance_body[:, 2].min())
    away = float(np.linalg.norm(robot.stance_body[:, :2], axis=1).max())
    far = _FAR + away
    gait = ", ".join(_text(name) for name in proposal.named.gait)
    way = f"{1e3 * step * _ROUNDS:.0f} mm over flat ground"
    return f"""# {robot.name} walks {way}, one leg at a time.
kind: climb
title: {_text(f"{robot.name} on flat ground")}
robot: {_text(robot_file)}

terrain:
  friction: {_FRICTION:g}  # ASSUMED: rubber on a floor
  ground: {{across: [-{far:.1f}, {far:.1f}], along: [-{far:.1f}, {far:.1f}]}}

task:
  rounds: {_ROUNDS}
  start: {{com: [0, 0, {height:.4f}]}}  # toes stand where the robot's stance meets the ground
  goal: {{com: [0, {step * _ROUNDS:.4f}, {height:.4f}]}}
  gait: [{gait}]  # from rear to front, one side after the other

posture:
  steps: {{com_max: {1.5 * step:.4f}, toe_max: {3 * step:.4f}, shift_max: {_SHIFT * away:.3f}}}

force: {{safety_friction: {SAFETY:g}}}
trajectory: {{lift: {min(_LIFT * ball, 0.05):.4f}}}
seed: 0
"""


def chimney_document(proposal: Proposal, robot_file: str, brace: Posture) -> str:
    """Up between two walls, in one of its bracing postures."""
    robot = proposal.robot
    rise = min(_RISE * min(robot.stance_radius, 2 * brace.room), _LONGEST_STEP)
    reach = _FAR + float(np.abs(brace.toes).max())
    stance = "\n".join(
        f"    {_text(name)}: {_vector(toe)}"
        for name, toe in zip(robot.limb_names, brace.toes, strict=True)
    )
    gait = ", ".join(_text(name) for name in proposal.named.gait)
    ball = min(robot.stance_radius, 2 * brace.room)
    extent = f"[-{reach:.1f}, {reach:.1f}]"
    shift = f", shift_max: {2 * brace.shift:.3f}" if brace.shift > _NO_SHIFT else ""
    return f"""# {robot.name} climbs {1e3 * rise * _ROUNDS:.0f} mm between two walls.
kind: climb
title: {_text(f"{robot.name} between two walls")}
robot: {_text(robot_file)}

terrain:
  friction: {brace.friction:g}  # ASSUMED: {WALLS[brace.friction]}
  walls: {{gap: {brace.gap:.4f}, along: {extent}, up: {extent}}}

task:
  rounds: {_ROUNDS}
  start: {{com: [0, 0, 0]}}
  goal: {{com: [0, 0, {rise * _ROUNDS:.4f}]}}
  gait: [{gait}]
  stance:  # [m] toes against the walls, body frame: most room, motors least used
{stance}

posture:
  steps: {{com_max: {1.5 * rise:.4f}, toe_max: {3 * rise:.4f}{shift}}}

force: {{safety_friction: {SAFETY:g}}}
trajectory: {{lift: {min(_LIFT * ball, 0.05):.4f}}}
seed: 0
"""


def _text(value: str) -> str:
    """A scalar of YAML that reads back as this text."""
    plain = value.replace("_", "a").replace("-", "a").isalnum() and value[:1].isalpha()
    words = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
    return value if plain and value.lower() not in words else json.dumps(value)


def _mapping(values: dict[str, float]) -> str:
    return "{" + ", ".join(f"{_text(n)}: {v:g}" for n, v in values.items()) + "}"


def _vector(values: Array) -> str:
    return "[" + ", ".join(f"{float(v):.4f}" for v in values) + "]"


def paths(proposal: Proposal, directory: Path) -> str:
    """The URDF's path as a robot file in `directory` names it: relative where it is near."""
    urdf = proposal.draft.urdf
    here = directory.resolve()
    for up, parent in enumerate((here, *list(here.parents)[:2])):
        if urdf.is_relative_to(parent) and parent != Path(parent.anchor):
            return "/".join([".."] * up + [urdf.relative_to(parent).as_posix()])
    return str(urdf)
