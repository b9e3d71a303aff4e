"""A walk of a proposed robot, as a spec of `plan-mpc`."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from climbplan.robots.urdf.walking_body import WalkingBody

_SPEED = 0.5  # [m/s]
_FROUDE = 0.35  # of the speed at which a pendulum of the standing height takes off, at most
_STEP = 0.27  # [s / sqrt(m)] of an interval by the standing height: a pendulum's time
STANCE = 3  # intervals that a leg stands in a walking trot
_IN_REACH = 0.8  # of its box, that the body moves on meanwhile
_LIFT = 0.8  # of a box's half height, at most
_HIGHEST = 0.05  # [m]
_EFFORT = 0.28  # of torque limits, that swinging a leg takes at most where longer intervals do
_FINER = 20  # intervals that are looked at
_KNOTS = 16
_TRIED = 6000  # steps of the QP solver in a tick: programs with joints take 100 to 200 each
_FRICTION = 0.8
_AHEAD, _ROUND = 100.0, 10.0  # weights of the velocity ahead, and of the yaw
_TURN = 45.0  # [deg] on the spot


def walk_document(
    body: WalkingBody,
    robot_file: str,
    effort: Callable[[float, float, float], float],
    turns: bool = False,
    haste: float = 1.0,
    slower: float = 1.0,
) -> str:
    """The spec: forward from rest by a walking trot, diagonals or tripods in turn; or round.

    effort: the share of torque limits that a swing at a speed [m/s], in an interval [s], lifted by
    so much [m], takes. Legs that are heavy for their motors swing in longer intervals, as far as
    their boxes let the body move on meanwhile. haste: times as much as usual, that the velocity
    ahead, or the yaw, weighs against a calm body. slower: times as long intervals.
    """
    half, height = body.boxes.half, body.height
    speed = min(_SPEED, _FROUDE * float(np.sqrt(body.gravity * height)))
    lift = min(_LIFT * float(half[2]), _HIGHEST)
    longest = 2 * _IN_REACH * float(half[0]) / (STANCE * speed)
    step = min(_STEP * float(np.sqrt(height)), longest)
    for wanted in np.linspace(step, longest, _FINER):
        step = float(wanted)
        if effort(speed, step, lift) <= _EFFORT:
            break
    step *= slower
    size = " x ".join(f"{2e3 * value:.0f}" for value in half)
    what, end = (f"walks forward at {speed:.2g} m/s", "walk")
    if turns:
        what, end, speed = (f"turns by {_TURN:g} degrees on the spot", "turn", 0.0)
    yaw = _TURN if turns else 0.0
    name = robot_file.removesuffix(".yaml").removesuffix("_walking")
    ahead, about = _AHEAD, _ROUND
    if turns:
        about *= haste
    else:
        ahead *= haste
    calm = "a calm body" if haste == 1.0 else "less calm a body lags behind"
    return f"""# {body.name} {what}, every other leg at a time.
#
#     climbplan plan-mpc {name}_{end}.yaml
#
# Axes of walking: x forward, y to the left. As it stands the body is {height:.3f} m above the toes;
# boxes of toes are {size} mm, in which every leg holds {body.boxes.force:.0f} N upright anywhere.
kind: mpc
title: {json.dumps(f"{body.name} {what}")}
robot: {json.dumps(robot_file)}
terrain: {{friction: {_FRICTION:g}}}  # ASSUMED: rubber on a floor

task:
  knots: {_KNOTS}  # up to 40
  step: {step:.3f}  # [s]
  least_contacts: {len(body.leg_names) // 2}
  lift: {lift:.3f}
  reference: {{velocity: [{speed:.2g}, 0, 0], rpy_deg: [0, 0, {yaw:g}]}}

weights: {{velocity: [{ahead:g}, 100, 1000], angles: [100, 100, {about:g}], height: 1000}}  # {calm}
solver: {{method: nlp, guess: walking trot}}
loop: {{effort: {_TRIED}}}  # of `--method online`: intervals leave time to try more gaits
seed: 0
"""
