"""Specs that use a proposed robot: over ground, up stairs, between walls, from ground to walls."""

from __future__ import annotations

import numpy as np

from climbplan.robots.capsules import limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.urdf.proposal.bracing_grid_search import FRICTION_SAFETY, WALL_FRICTIONS
from climbplan.robots.urdf.proposal.postures import LeggedPosture
from climbplan.robots.urdf.proposal.prepared_robot import FLOOR_FRICTION, RobotProposal
from climbplan.robots.urdf.proposal.yaml_format import format_scalar, format_vector

# Fractions of the stance radius, the ball about its stance that a toe reaches:
_STEP = 0.35  # of a toe in a round on ground
_RISE = 0.3  # of a toe in a round between walls
_LONGEST_STEP = 0.08  # [m]
_COM_STEP = 1.5  # largest step of the body, over that of a round
_TOE_STEP = 4.0  # largest step of a toe, over that of the body: it moves once while four limbs do
_TOE_RANGE = 2.0  # largest step of a toe, over the stance radius: across the ball that it reaches
_MAX_SHIFT = 0.6  # of the body, over the horizontal distance of the farthest toe
_MAX_SHIFT_OVER_SOLE = 1.25  # of that distance, where the body goes over one of two soles
_SOLE_STEP_TIME = 4.0  # [s] of a step on flat feet
# Times are those of pendulums, by the root of a length. The trajectory takes more where joint
# speeds or the body's inertia ask for it.
_STEP_TIME = 4.0  # [s] of a step, over the root of a toe's level distance from the body [m]
_BRACED_STEP_TIME = 2.0  # [s] of a step between walls, over that root
_WALL_SPEED = 0.05  # [m/s] of the body on its way to walls, over that root
_LIFT = 0.25  # of a toe, over the stance radius
_SOLE_LIFT = 0.1  # of a sole, over its length
_MAX_LIFT = 0.05  # [m]
_ROUNDS = 2
_MIN_SHIFT = 1e-3  # [m]
_TERRAIN_MARGIN = 3.0  # [m] of ground and walls beyond the robot
_STAIR_STEP = 0.6  # of a toe in a round on stairs, over the stance radius
_STAIR_HEIGHT = 0.25  # over the stance radius
_GENTLE_STEP, _GENTLE_STAIR_HEIGHT = 0.5, 0.15  # where that fails
_MAX_STAIR_HEIGHT = 0.05  # [m]
_EDGE_LIFT = 1.5  # of toes, over a stair's height
_STAIR_ROUNDS = 4
_MAX_WALL_TORQUE_SAFETY = 1.2  # S_tau on the way to the walls
_BRACE_SAFETY_RATIO = 0.9  # of the S_tau that the posture between walls has
_WALL_HEIGHTS = 4
_LATERAL_SEARCH = 0.12  # off the straight path, over the distance of the farthest toe
_MIN_TOE_HEIGHT = 0.05  # [m] of the lowest toe on a wall
_MIN_LINK_HEIGHT = 0.03  # [m] of the lowest link above the ground


_UNCERTAIN = """uncertainty:  # ASSUMED, standard deviations of the worlds in which plans are judged
  friction: 0.2  # of each surface, as a share of its coefficient
  surface_mm: 3  # how far each surface lies off its place
"""


def format_ground_document(proposal: RobotProposal, robot_file: str) -> str:
    """Return the spec of a few steps over flat ground.

    Args:
        proposal: The robot.
        robot_file: Name of the robot file.
    """
    robot = proposal.robot
    radius = robot.stance_radius
    step = min(_STEP * radius, _LONGEST_STEP)
    height, distance, shift = _measure_stance(proposal)
    extent = _TERRAIN_MARGIN + distance
    gait = ", ".join(format_scalar(name) for name in proposal.naming.gait)
    action = f"{1e3 * step * _ROUNDS:.0f} mm over flat ground"
    return f"""# {robot.name} walks {action}, one leg at a time.
kind: climb
title: {format_scalar(f"{robot.name} on flat ground")}
robot: {format_scalar(robot_file)}

terrain:
  friction: {FLOOR_FRICTION:g}  # ASSUMED: rubber on a floor
{_format_floor(proposal, extent)}

task:
  rounds: {_ROUNDS}
{_format_start(proposal)}
  goal: {{com: [0, {step * _ROUNDS:.4f}, {height:.4f}]}}
  gait: [{gait}]  # from rear to front, one side after the other

posture:
  steps: {{{_format_steps(step, radius)}, com_shift_max: {shift:.3f}}}

force: {{safety_friction: {FRICTION_SAFETY:g}}}
trajectory: {{swing_clearance: {_choose_lift(robot, radius):.4f}{_format_speed(proposal, step)}}}
{_UNCERTAIN}seed: 0
"""


def format_chimney_document(proposal: RobotProposal, robot_file: str, brace: LeggedPosture) -> str:
    """Return the spec of a climb up between two walls.

    Args:
        proposal: The robot.
        robot_file: Name of the robot file.
        brace: The bracing posture, body frame.
    """
    robot = proposal.robot
    rise = min(_RISE * min(robot.stance_radius, 2 * brace.reach_margin), _LONGEST_STEP)
    reach = _TERRAIN_MARGIN + float(np.abs(brace.toes).max())
    stance = "\n".join(
        f"    {format_scalar(name)}: {format_vector(toe)}"
        for name, toe in zip(robot.limb_names, brace.toes, strict=True)
    )
    gait = ", ".join(format_scalar(name) for name in proposal.naming.gait)
    radius = min(robot.stance_radius, 2 * brace.reach_margin)
    extent = f"[-{reach:.1f}, {reach:.1f}]"
    distance = float(np.linalg.norm(brace.toes[:, :2], axis=1).max())
    speed = rise / (_BRACED_STEP_TIME * np.sqrt(distance) * robot.limb_count)
    shift = f", com_shift_max: {2 * brace.shift:.3f}" if brace.shift > _MIN_SHIFT else ""
    return f"""# {robot.name} climbs {1e3 * rise * _ROUNDS:.0f} mm between two walls.
kind: climb
title: {format_scalar(f"{robot.name} between two walls")}
robot: {format_scalar(robot_file)}

terrain:
  friction: {brace.friction:g}  # ASSUMED: {WALL_FRICTIONS[brace.friction]}
  walls: {{gap: {_compute_wall_gap(proposal, brace.gap):.4f}, along: {extent}, up: {extent}}}

task:
  rounds: {_ROUNDS}
  start: {{com: [0, 0, 0]}}
  goal: {{com: [0, 0, {rise * _ROUNDS:.4f}]}}
  gait: [{gait}]
  stance:  # [m] toes against the walls, body frame: most room, motors least used
{stance}

posture:
  steps: {{{_format_steps(rise, radius)}{shift}}}

force: {{safety_friction: {FRICTION_SAFETY:g}}}
trajectory: {{swing_clearance: {_choose_lift(robot, radius):.4f}, speed: {speed:.2g}}}
{_UNCERTAIN}seed: 0
"""


def format_stairs_document(
    proposal: RobotProposal, robot_file: str, leans: bool = True, gentle: bool = False
) -> str:
    """Return the spec of a walk up two stairs.

    Front toes climb two stairs, those of the middle one, and rear toes stay below.

    Args:
        proposal: The robot.
        robot_file: Name of the robot file.
        leans: Whether the body pitches with the stance, if that is long enough.
        gentle: Whether stairs are lower and steps shorter, which leaves space before and behind an
            edge for thick hands.
    """
    robot = proposal.robot
    radius = robot.stance_radius
    step = (_GENTLE_STEP if gentle else _STAIR_STEP) * radius
    stair = min((_GENTLE_STAIR_HEIGHT if gentle else _STAIR_HEIGHT) * radius, _MAX_STAIR_HEIGHT)
    height, distance, shift = _measure_stance(proposal)
    forward = robot.stance_body[~np.array(proposal.naming.is_arm), 1]
    front, rear = float(forward.max()), float(forward.min())
    # The last steps of the front toes are taken on the second stair
    edge_steps = (0.66, _STAIR_ROUNDS - 0.34) if gentle else (0.6, _STAIR_ROUNDS - 0.9)
    first, second = (front + edge_step * step for edge_step in edge_steps)
    pitch = 0.0
    if leans and front - rear > distance:
        pitch = float(np.rad2deg(np.arctan2(2 * stair, front - rear)))
    gait = ", ".join(format_scalar(name) for name in proposal.naming.gait)
    walls = (
        f"{_format_walls(proposal, _TERRAIN_MARGIN + distance)}\n" if proposal.posture.gap else ""
    )
    return f"""# {robot.name} walks up two stairs of {1e3 * stair:.0f} mm, one leg at a time.
kind: climb
title: {format_scalar(f"{robot.name} on stairs")}
robot: {format_scalar(robot_file)}

terrain:
  friction: {FLOOR_FRICTION:g}  # ASSUMED: rubber on a floor
{walls}  regions:
{_format_stairs(first, second, stair, distance)}

task:
  rounds: {_STAIR_ROUNDS}
{_format_start(proposal)}
  goal: {{com: [0, {step * _STAIR_ROUNDS:.4f}, {height + stair:.4f}], rpy_deg: [{pitch:.1f}, 0, 0]}}
  gait: [{gait}]  # from rear to front, one side after the other

posture:
  steps: {{{_format_steps(step, radius)}, com_shift_max: {shift:.3f}}}

force: {{safety_friction: {FRICTION_SAFETY:g}}}
trajectory: {{swing_clearance: {_EDGE_LIFT * stair:.4f}{_format_speed(proposal, step)}}}
{_UNCERTAIN}seed: 0
"""


def _format_stairs(first: float, second: float, stair: float, distance: float) -> str:
    """Return the floor and two stairs as regions.

    Args:
        first: Place of the first edge along the walk [m].
        second: Place of the second edge [m].
        stair: Height of a stair [m].
        distance: Horizontal distance of the farthest toe from the body [m].
    """
    width = 2 * (_TERRAIN_MARGIN + distance)
    edges = {
        "floor": (-_TERRAIN_MARGIN - distance, first, 0.0),
        "first stair": (first, second, stair),
        "second stair": (second, second + _TERRAIN_MARGIN, 2 * stair),
    }
    return "\n".join(
        f"    - name: {name}\n      rectangle: {{center: [0, {(low + high) / 2:.4f}, {z:.4f}], "
        f"normal: [0, 0, 1], width: {width:.1f}, height: {high - low:.4f}}}"
        for name, (low, high, z) in edges.items()
    )


def format_wall_document(
    proposal: RobotProposal, robot_file: str, brace: LeggedPosture, rise: float = 0.0
) -> str:
    """Return the spec of a transition from standing on the ground to bracing between walls.

    Args:
        proposal: The robot.
        robot_file: Name of the robot file.
        brace: The bracing posture, body frame.
        rise: Of the body, over its height as it stands: knees that are bent outward may touch the
            ground without.
    """
    robot = proposal.robot
    height, distance, shift = _measure_stance(proposal)
    min_height = float(brace.toes[:, 2].min()) - robot.standoff
    up = max(
        (1 + rise) * height,
        _MIN_TOE_HEIGHT - min_height,
        _MIN_LINK_HEIGHT - _find_lowest_link(robot, brace),
    )
    extent = _TERRAIN_MARGIN + distance
    stance = "\n".join(
        f"    {format_scalar(name)}: {format_vector(toe)}"
        for name, toe in zip(robot.limb_names, brace.toes, strict=True)
    )
    shift = max(shift, 2 * brace.shift)
    lift = _choose_lift(robot, min(robot.stance_radius, 2 * brace.reach_margin))
    lateral_offset = _LATERAL_SEARCH * distance + 0.5 * brace.shift
    rounds, gap = robot.limb_count, _compute_wall_gap(proposal, brace.gap)
    half = gap / 2
    torque = min(
        _MAX_WALL_TORQUE_SAFETY, max(1.0, _BRACE_SAFETY_RATIO / max(brace.utilisation, 1e-3))
    )
    return f"""# {robot.name} goes from the ground to two walls, in {rounds} rounds.
#
#     climbplan plan-transition {robot_file.removesuffix(".yaml")}_wall.yaml
kind: transition
title: {format_scalar(f"{robot.name} from the ground to two walls")}
robot: {format_scalar(robot_file)}

terrain:
  friction: {brace.friction:g}  # ASSUMED: {WALL_FRICTIONS[brace.friction]}
  walls: {{gap: {gap:.4f}, along: [-{extent:.1f}, {extent:.1f}], up: [0, {extent:.1f}]}}
  ground: {{across: [-{half:.4f}, {half:.4f}], along: [-{extent:.1f}, {extent:.1f}]}}

task:
  rounds: {rounds}
{_format_start(proposal, gap)}
  goal: {{com: [0, 0, {up:.4f}]}}
  stance:  # [m] toes against the walls, body frame
{stance}

posture:
  steps: {{com_shift_max: {shift:.3f}, com_max: {2 * shift:.3f}}}

search: {{lateral_offset: {lateral_offset:.3f}, heights: {_WALL_HEIGHTS}}}
force: {{safety_torque: {torque:.2f}}}
trajectory: {{swing_clearance: {lift:.4f}, speed: {_WALL_SPEED * np.sqrt(distance):.2g}}}
{_UNCERTAIN}seed: 0
"""


def _format_steps(step: float, radius: float) -> str:
    """Return the keys of the largest steps of body and toes.

    Args:
        step: Of the body in a round [m].
        radius: Of the ball about its stance that a toe reaches [m].
    """
    com = _COM_STEP * step
    toe = max(2 * com, min(_TOE_STEP * com, _TOE_RANGE * radius))
    return f"com_max: {com:.4f}, toe_max: {toe:.4f}"


def _choose_lift(robot: Robot, radius: float) -> float:
    """Return how far toes are lifted [m]; radius: of the ball that a toe reaches [m].

    Long soles are lifted further: their ends come near the ground as the body moves.
    """
    lift = _LIFT * radius
    if robot.sole is not None:
        lift = max(lift, _SOLE_LIFT * robot.sole.length)
    return min(lift, _MAX_LIFT)


def _find_lowest_link(robot: Robot, brace: LeggedPosture) -> float:
    """Return the height of the lowest point of links in a bracing posture, body frame [m]."""
    links = limb_capsules(robot, brace.angles)
    lowest = np.minimum(links.starts[..., 2], links.ends[..., 2]) - links.radius
    return float(np.nanmin(lowest))


def _compute_wall_gap(proposal: RobotProposal, toe_gap: float) -> float:
    """Return the distance between walls on which toes are so far apart [m]."""
    return toe_gap + 2 * proposal.robot.standoff


def _measure_stance(proposal: RobotProposal) -> tuple[float, float, float]:
    """Return the body's height, the horizontal distance of its farthest toe, and its shift [m]."""
    stance = proposal.robot.stance_body
    distance = float(np.linalg.norm(stance[:, :2], axis=1).max())
    shift = 2 * proposal.posture.shift if proposal.posture.gap else _MAX_SHIFT * distance
    if proposal.robot.sole is not None:
        shift = _MAX_SHIFT_OVER_SOLE * distance
    return float(-stance[:, 2].min()) + proposal.robot.standoff, distance, shift


def _format_speed(proposal: RobotProposal, step: float) -> str:
    """Return the speed key of a quasi-static walk that advances by `step` a round [m]."""
    limbs = proposal.robot.limb_count
    if proposal.robot.sole is not None:
        return f", speed: {step / (_SOLE_STEP_TIME * limbs):.2g}"
    distance = _measure_stance(proposal)[1]
    return f", speed: {step / (_STEP_TIME * np.sqrt(distance) * limbs):.2g}"


def _format_start(proposal: RobotProposal, gap: float = 0.0) -> str:
    """Return the start of a task: toes on the ground, and those of arms on walls.

    gap: distance between the walls [m]; 0 for that of the stance.
    """
    robot, posture = proposal.robot, proposal.posture
    height = _measure_stance(proposal)[0]
    if not (gap or posture.gap):
        comment = "# toes stand where the robot's stance meets the ground"
        return f"  start: {{com: [0, 0, {height:.4f}]}}  {comment}"
    toes = robot.stance_body.copy()
    arms = np.array(proposal.naming.is_arm) & (posture.gap > 0)
    toes[:, 2] = np.where(arms, toes[:, 2] + height, 0.0)
    toes[arms, 0] = (
        np.sign(toes[arms, 0]) * round(gap or _compute_wall_gap(proposal, posture.gap), 4) / 2
    )
    listed = "\n".join(
        f"      {format_scalar(name)}: {format_vector(toe, 5 if arm else 4)}"
        for name, toe, arm in zip(robot.limb_names, toes, arms, strict=True)
    )
    return f"  start:\n    com: [0, 0, {height:.4f}]\n    toes:  # [m] as it stands\n{listed}"


def _format_floor(proposal: RobotProposal, extent: float) -> str:
    """Return the ground, and walls for the hands of a robot that stands between them."""
    gap = proposal.posture.gap
    half_width = f"{_compute_wall_gap(proposal, gap) / 2:.4f}" if gap else f"{extent:.1f}"
    ground = (
        f"  ground: {{across: [-{half_width}, {half_width}], along: [-{extent:.1f}, {extent:.1f}]}}"
    )
    return f"{ground}\n{_format_walls(proposal, extent)}" if gap else ground


def _format_walls(proposal: RobotProposal, extent: float) -> str:
    gap = _compute_wall_gap(proposal, proposal.posture.gap)
    return (
        f"  walls: {{gap: {gap:.4f}, along: [-{extent:.1f}, {extent:.1f}], up: [0, {extent:.1f}]}}"
    )
