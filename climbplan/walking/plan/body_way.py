"""Where the body of a walk is between two samples of its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY


@dataclass(frozen=True)
class Moving:
    """The body at a time, as planned; world frame."""

    position: Array  # (3,) of the centre of mass as it stands
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    rotation: Array  # (3, 3)
    spin: Array  # (3,)
    turning: Array  # (3,) angular acceleration


def body_within(plan: WalkPlan, n: int, time: float) -> Moving:
    """Return the body at a time of the interval from sample n to the next.

    Velocities go straight, and positions so that they meet both samples. Slightly outside the
    interval the same curves go on.
    """
    task, state = plan.task, plan.trajectory.state
    span = task.step
    s = time - n * task.step
    one, other = state[n], state[n + 1]
    push = plan.loop.push[n + 1] if plan.loop is not None else np.zeros(3)
    # What a push adds comes at once, not by planned forces
    acceleration = (other[VELOCITY] - push - one[VELOCITY]) / span
    curve = one[POSITION] + s * one[VELOCITY] + 0.5 * s**2 * acceleration
    end = one[POSITION] + span * one[VELOCITY] + 0.5 * span**2 * acceleration
    share = s / span
    return Moving(
        position=curve + share * (other[POSITION] - end),
        velocity=one[VELOCITY] + s * acceleration,
        acceleration=acceleration,
        rotation=rotation_world_body(one[ANGLES] + share * (other[ANGLES] - one[ANGLES])),
        spin=one[SPIN] + share * (other[SPIN] - one[SPIN]),
        turning=(other[SPIN] - one[SPIN]) / span,
    )
