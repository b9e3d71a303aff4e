"""Specs that use a proposed robot: over ground, up stairs, between walls, from ground to walls."""

from __future__ import annotations

import numpy as np

from climbplan.robots.urdf.proposal.braces import SAFETY, WALLS
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.settled import FLOOR, Proposal
from climbplan.robots.urdf.proposal.yaml_words import scalar, vector

_STEP = 0.35  # of the ball about its stance, that a toe steps in a round on ground
_RISE = 0.3  # and between walls
_LONGEST_STEP = 0.08  # [m]
_SHIFT = 0.6  # of the level distance of a toe from the body, that it may shift at most
_OVER_SOLE = 1.25  # of that, where it goes over one of two soles
_SOLE_TIME = 4.0  # [s] of a step then
_PACE = 0.2 / 60  # [m/s] the default, at which the body goes on at most
_STEP_TIME = 13.5  # [s] of a step, by the root of a toe's level distance from the body [m]: to go
# from over three legs to over three others a body then speeds up by some 1.5 % of gravity
_LIFT = 0.25  # of the ball, that a toe is lifted
_ROUNDS = 2
_NO_SHIFT = 1e-3  # [m]
_FAR = 3.0  # [m] of ground and walls beyond the robot
_STAIR_STEP = 0.6  # of the ball about its stance, that a toe steps on stairs in a round
_STAIR = 0.25  # of the ball, that a stair is high
_GENTLE_STEP, _GENTLE_STAIR = 0.5, 0.15  # where that does not do
_HIGHEST_STAIR = 0.05  # [m]
_OVER_EDGE = 1.5  # of a stair's height, that toes are lifted
_STAIR_ROUNDS = 4
_WALL_TORQUE = 1.2  # S_tau on the way to the walls, if the posture there has so much
_OF_BRACE = 0.9  # of the S_tau that the posture between walls has
_WALL_HEIGHTS = 4
_ASIDE = 0.12  # of the level distance of a toe from the body: poses beside the straight way
_ABOVE_GROUND = 0.05  # [m] of the lowest toe on a wall


_UNCERTAIN = """uncertainty:  # ASSUMED, standard deviations of the worlds in which plans are judged
  friction: 0.2  # of each surface, as a share of its coefficient
  surface_mm: 3  # how far each surface lies off its place
"""


def ground_document(proposal: Proposal, robot_file: str) -> str:
    """A few steps over flat ground."""
    robot = proposal.robot
    ball = robot.stance_radius
    step = min(_STEP * ball, _LONGEST_STEP)
    height, away, shift = _stands(proposal)
    far = _FAR + away
    gait = ", ".join(scalar(name) for name in proposal.named.gait)
    way = f"{1e3 * step * _ROUNDS:.0f} mm over flat ground"
    return f"""# {robot.name} walks {way}, one leg at a time.
kind: climb
title: {scalar(f"{robot.name} on flat ground")}
robot: {scalar(robot_file)}

terrain:
  friction: {FLOOR:g}  # ASSUMED: rubber on a floor
{_floor(proposal, far)}

task:
  rounds: {_ROUNDS}
{_start(proposal)}
  goal: {{com: [0, {step * _ROUNDS:.4f}, {height:.4f}]}}
  gait: [{gait}]  # from rear to front, one side after the other

posture:
  steps: {{com_max: {1.5 * step:.4f}, toe_max: {3 * step:.4f}, shift_max: {shift:.3f}}}

force: {{safety_friction: {SAFETY:g}}}
trajectory: {{lift: {min(_LIFT * ball, 0.05):.4f}{_pace(proposal, step)}}}
{_UNCERTAIN}seed: 0
"""


def chimney_document(proposal: Proposal, robot_file: str, brace: Posture) -> str:
    """Up between two walls, in one of its bracing postures."""
    robot = proposal.robot
    rise = min(_RISE * min(robot.stance_radius, 2 * brace.room), _LONGEST_STEP)
    reach = _FAR + float(np.abs(brace.toes).max())
    stance = "\n".join(
        f"    {scalar(name)}: {vector(toe)}"
        for name, toe in zip(robot.limb_names, brace.toes, strict=True)
    )
    gait = ", ".join(scalar(name) for name in proposal.named.gait)
    ball = min(robot.stance_radius, 2 * brace.room)
    extent = f"[-{reach:.1f}, {reach:.1f}]"
    shift = f", shift_max: {2 * brace.shift:.3f}" if brace.shift > _NO_SHIFT else ""
    return f"""# {robot.name} climbs {1e3 * rise * _ROUNDS:.0f} mm between two walls.
kind: climb
title: {scalar(f"{robot.name} between two walls")}
robot: {scalar(robot_file)}

terrain:
  friction: {brace.friction:g}  # ASSUMED: {WALLS[brace.friction]}
  walls: {{gap: {_apart(proposal, brace.gap):.4f}, along: {extent}, up: {extent}}}

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
{_UNCERTAIN}seed: 0
"""


def stairs_document(
    proposal: Proposal, robot_file: str, leans: bool = True, gentle: bool = False
) -> str:
    """Up two stairs with the front toes, one with those of the middle; rear ones stay below.

    leans: the body pitches with the stance, if that is long enough. gentle: lower stairs and
    shorter steps, which leave room before and behind an edge for hands that are thick.
    """
    robot = proposal.robot
    ball = robot.stance_radius
    step = (_GENTLE_STEP if gentle else _STAIR_STEP) * ball
    stair = min((_GENTLE_STAIR if gentle else _STAIR) * ball, _HIGHEST_STAIR)
    height, away, shift = _stands(proposal)
    along = robot.stance_body[~np.array(proposal.named.arms), 1]
    front, rear = float(along.max()), float(along.min())
    # The last steps of the front toes are taken on the second stair
    before = (0.66, _STAIR_ROUNDS - 0.34) if gentle else (0.6, _STAIR_ROUNDS - 0.9)
    first, second = (front + share * step for share in before)
    pitch = 0.0
    if leans and front - rear > away:
        pitch = float(np.rad2deg(np.arctan2(2 * stair, front - rear)))
    wide = 2 * (_FAR + away)
    edges = {"floor": (-_FAR - away, first, 0.0), "first stair": (first, second, stair)}
    edges["second stair"] = (second, second + _FAR, 2 * stair)
    regions = "\n".join(
        f"    - name: {name}\n      rectangle: {{center: [0, {(low + high) / 2:.4f}, {at:.4f}], "
        f"normal: [0, 0, 1], width: {wide:.1f}, height: {high - low:.4f}}}"
        for name, (low, high, at) in edges.items()
    )
    gait = ", ".join(scalar(name) for name in proposal.named.gait)
    walls = f"{_walls(proposal, _FAR + away)}\n" if proposal.posture.gap else ""
    return f"""# {robot.name} walks up two stairs of {1e3 * stair:.0f} mm, one leg at a time.
kind: climb
title: {scalar(f"{robot.name} on stairs")}
robot: {scalar(robot_file)}

terrain:
  friction: {FLOOR:g}  # ASSUMED: rubber on a floor
{walls}  regions:
{regions}

task:
  rounds: {_STAIR_ROUNDS}
{_start(proposal)}
  goal: {{com: [0, {step * _STAIR_ROUNDS:.4f}, {height + stair:.4f}], rpy_deg: [{pitch:.1f}, 0, 0]}}
  gait: [{gait}]  # from rear to front, one side after the other

posture:
  steps: {{com_max: {1.5 * step:.4f}, toe_max: {3 * step:.4f}, shift_max: {shift:.3f}}}

force: {{safety_friction: {SAFETY:g}}}
trajectory: {{lift: {_OVER_EDGE * stair:.4f}{_pace(proposal, step)}}}
{_UNCERTAIN}seed: 0
"""


def wall_document(proposal: Proposal, robot_file: str, brace: Posture) -> str:
    """From standing on the ground to bracing between walls, in one of its bracing postures."""
    robot = proposal.robot
    height, away, shift = _stands(proposal)
    lowest = float(brace.toes[:, 2].min()) - robot.standoff
    up = max(height, _ABOVE_GROUND - lowest)
    far = _FAR + away
    stance = "\n".join(
        f"    {scalar(name)}: {vector(toe)}"
        for name, toe in zip(robot.limb_names, brace.toes, strict=True)
    )
    shift = max(shift, 2 * brace.shift)
    lift = min(_LIFT * min(robot.stance_radius, 2 * brace.room), 0.05)
    rounds, gap = robot.limb_count, _apart(proposal, brace.gap)
    half = gap / 2
    torque = min(_WALL_TORQUE, max(1.0, _OF_BRACE / max(brace.use, 1e-3)))
    return f"""# {robot.name} goes from the ground to two walls, in {rounds} rounds.
#
#     climbplan plan-transition {robot_file.removesuffix(".yaml")}_wall.yaml
kind: transition
title: {scalar(f"{robot.name} from the ground to two walls")}
robot: {scalar(robot_file)}

terrain:
  friction: {brace.friction:g}  # ASSUMED: {WALLS[brace.friction]}
  walls: {{gap: {gap:.4f}, along: [-{far:.1f}, {far:.1f}], up: [0, {far:.1f}]}}
  ground: {{across: [-{half:.4f}, {half:.4f}], along: [-{far:.1f}, {far:.1f}]}}

task:
  rounds: {rounds}
{_start(proposal, gap)}
  goal: {{com: [0, 0, {up:.4f}]}}
  stance:  # [m] toes against the walls, body frame
{stance}

posture:
  steps: {{shift_max: {shift:.3f}, com_max: {2 * shift:.3f}}}

search: {{aside: {_ASIDE * away + 0.5 * brace.shift:.3f}, heights: {_WALL_HEIGHTS}}}
force: {{safety_torque: {torque:.2f}}}
trajectory: {{lift: {lift:.4f}}}
{_UNCERTAIN}seed: 0
"""


def _apart(proposal: Proposal, toes: float) -> float:
    """How far walls are apart whose toes are so far apart [m]."""
    return toes + 2 * proposal.robot.standoff


def _stands(proposal: Proposal) -> tuple[float, float, float]:
    """Height of the body [m], of its farthest toe on the level, and how far it may shift."""
    stance = proposal.robot.stance_body
    away = float(np.linalg.norm(stance[:, :2], axis=1).max())
    shift = 2 * proposal.posture.shift if proposal.posture.gap else _SHIFT * away
    if proposal.robot.sole is not None:
        shift = _OVER_SOLE * away
    return float(-stance[:, 2].min()) + proposal.robot.standoff, away, shift


def _pace(proposal: Proposal, step: float) -> str:
    """How fast a robot goes that gets on by so much a round [m]: what is planned is statics."""
    limbs = proposal.robot.limb_count
    if proposal.robot.sole is not None:
        return f", speed: {step / (_SOLE_TIME * limbs):.2g}"
    away = _stands(proposal)[1]
    slow = step / (_STEP_TIME * np.sqrt(away) * limbs)
    return f", speed: {slow:.2g}" if slow < _PACE else ""


def _start(proposal: Proposal, gap: float = 0.0) -> str:
    """The start of a task: toes on the ground, and of arms on walls that far apart [m]."""
    robot, posture = proposal.robot, proposal.posture
    height = _stands(proposal)[0]
    if not (gap or posture.gap):
        words = "# toes stand where the robot's stance meets the ground"
        return f"  start: {{com: [0, 0, {height:.4f}]}}  {words}"
    toes = robot.stance_body.copy()
    arms = np.array(proposal.named.arms) & (posture.gap > 0)
    toes[:, 2] = np.where(arms, toes[:, 2] + height, 0.0)
    toes[arms, 0] = np.sign(toes[arms, 0]) * round(gap or _apart(proposal, posture.gap), 4) / 2
    listed = "\n".join(
        f"      {scalar(name)}: {vector(toe, 5 if arm else 4)}"
        for name, toe, arm in zip(robot.limb_names, toes, arms, strict=True)
    )
    return f"  start:\n    com: [0, 0, {height:.4f}]\n    toes:  # [m] as it stands\n{listed}"


def _floor(proposal: Proposal, far: float) -> str:
    """Ground, and walls for the hands of a robot that stands between them."""
    gap = proposal.posture.gap
    across = f"{_apart(proposal, gap) / 2:.4f}" if gap else f"{far:.1f}"
    ground = f"  ground: {{across: [-{across}, {across}], along: [-{far:.1f}, {far:.1f}]}}"
    return f"{ground}\n{_walls(proposal, far)}" if gap else ground


def _walls(proposal: Proposal, far: float) -> str:
    gap = _apart(proposal, proposal.posture.gap)
    return f"  walls: {{gap: {gap:.4f}, along: [-{far:.1f}, {far:.1f}], up: [0, {far:.1f}]}}"
