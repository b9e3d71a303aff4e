"""The walk of a proposed robot as a spec of `plan-mpc`."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from climbplan.robots.urdf.walking_body import WalkingBody

_SPEED = 0.5  # [m/s]
_MAX_FROUDE = 0.35  # speed over that at which a pendulum of standing height takes off
_INTERVAL_SCALE = 0.27  # [s / sqrt(m)] interval over root of standing height: a pendulum's time
STANCE_INTERVALS = 3  # of a leg in a walking trot
_MAX_BOX_FRACTION = 0.8  # of a toe's box, that the body travels meanwhile
_MAX_LIFT_RATIO = 0.8  # of a box's half height
_MAX_LIFT = 0.05  # [m]
_MAX_SWING_EFFORT = 0.28  # of torque limits, unless the longest intervals need more
_MAX_JOINT_SPEED = 0.75  # of joint speed limits in a swing, as motors overshoot
_MIN_SPEED_FACTOR, _NUM_SPEEDS = 0.1, 16  # of the body's speed, and how many are tried
_NUM_INTERVALS = 20  # lengths that are tried
_KNOTS = 16
_QP_ITERATIONS = 6000  # in a tick: programs with joints take 100 to 200 each
_FRICTION = 0.8
_FORWARD_WEIGHT, _YAW_WEIGHT = 100.0, 10.0
_TURN = 45.0  # [deg] on the spot


def format_walk_document(
    body: WalkingBody,
    robot_file: str,
    effort: Callable[[float, float, float], float],
    turns: bool = False,
    haste: float = 1.0,
    slower: float = 1.0,
    *,
    joint_speed: Callable[[float, float, float], float] = lambda speed, interval, lift: 0.0,
) -> str:
    """Return the spec: forward from rest by a walking trot, or a turn on the spot.

    A walking trot lifts diagonals or tripods in turn. Heavy legs swing in longer intervals, as far
    as their boxes let the body travel meanwhile. Slow joints make the body slower.

    Args:
        body: The robot as walking has it.
        robot_file: Name of the robot file.
        effort: Fraction of torque limits of a swing, by speed [m/s], interval [s] and lift [m].
        turns: Whether the robot turns on the spot.
        haste: Factor on the weight of the forward velocity, or of the yaw.
        slower: Factor on the length of intervals.
        joint_speed: Fraction of joint speed limits that a swing takes, of the same arguments.
    """
    half, height = body.boxes.half, body.height
    lift = min(_MAX_LIFT_RATIO * float(half[2]), _MAX_LIFT)
    speed = _choose_speed(body, joint_speed, lift)
    interval = slower * _choose_interval(body, effort, joint_speed, speed, lift)
    size = " x ".join(f"{2e3 * value:.0f}" for value in half)
    action, suffix = f"walks forward at {speed:.2g} m/s", "walk"
    if turns:
        action, suffix, speed = (f"turns by {_TURN:g} degrees on the spot", "turn", 0.0)
    name = robot_file.removesuffix(".yaml").removesuffix("_walking")
    forward_weight, yaw_weight = (
        (_FORWARD_WEIGHT, _YAW_WEIGHT * haste) if turns else (_FORWARD_WEIGHT * haste, _YAW_WEIGHT)
    )
    comment = "a calm body" if haste == 1.0 else "less calm a body lags behind"
    weights = f"velocity: [{forward_weight:g}, 100, 1000], angles: [100, 100, {yaw_weight:g}]"
    return f"""# {body.name} {action}, every other leg at a time.
#
#     climbplan plan-mpc {name}_{suffix}.yaml
#
# Axes of walking: x forward, y to the left. As it stands the body is {height:.3f} m above the toes;
# boxes of toes are {size} mm, in which every leg holds {body.boxes.force:.0f} N upright anywhere.
kind: mpc
title: {json.dumps(f"{body.name} {action}")}
robot: {json.dumps(robot_file)}
terrain: {{friction: {_FRICTION:g}}}  # ASSUMED: rubber on a floor

task:
  knots: {_KNOTS}  # up to 40
  dt: {interval:.3f}  # [s]
  min_contacts: {len(body.leg_names) // 2}
  swing_clearance: {lift:.3f}
  reference: {{velocity: [{speed:.2g}, 0, 0], rpy_deg: [0, 0, {_TURN * turns:g}]}}

weights: {{{weights}, height: 1000}}  # {comment}
solver: {{method: mpcc, initial_gait: walking trot}}
loop: {{max_qp_iterations: {_QP_ITERATIONS}}}  # of `--method online`: time for more gaits
seed: 0
"""


def _choose_speed(
    body: WalkingBody, joint_speed: Callable[[float, float, float], float], lift: float
) -> float:
    """Return the speed of the body [m/s] at which swings in the longest interval are slow enough.

    lift: height of swings [m].
    """
    max_speed = min(_SPEED, _MAX_FROUDE * float(np.sqrt(body.gravity * body.height)))
    speed = max_speed
    for factor in np.geomspace(1.0, _MIN_SPEED_FACTOR, _NUM_SPEEDS):
        speed = float(factor) * max_speed
        if joint_speed(speed, _compute_max_interval(body, speed), lift) <= _MAX_JOINT_SPEED:
            break
    return speed


def _compute_max_interval(body: WalkingBody, speed: float) -> float:
    """Return the longest interval [s] in which boxes let the body travel at a speed [m/s]."""
    return 2 * _MAX_BOX_FRACTION * float(body.boxes.half[0]) / (STANCE_INTERVALS * speed)


def _choose_interval(
    body: WalkingBody,
    effort: Callable[[float, float, float], float],
    joint_speed: Callable[[float, float, float], float],
    speed: float,
    lift: float,
) -> float:
    """Return the interval [s] of a pendulum's time, or the next one whose swings are easy enough.

    It is at most as long as boxes let the body travel meanwhile.
    """
    max_interval = _compute_max_interval(body, speed)
    interval = min(_INTERVAL_SCALE * float(np.sqrt(body.height)), max_interval)
    for length in np.linspace(interval, max_interval, _NUM_INTERVALS):
        interval = float(length)
        if (
            joint_speed(speed, interval, lift) <= _MAX_JOINT_SPEED
            and effort(speed, interval, lift) <= _MAX_SWING_EFFORT
        ):
            break
    return interval
