"""The body's motion between two samples of a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY


@dataclass(frozen=True)
class PlannedBody:
    """The planned motion of the body at a time, world frame."""

    position: Array  # (3,) of the centre of mass
    velocity: Array  # (3,)
    acceleration: Array  # (3,)
    rotation: Array  # (3, 3)
    angular_velocity: Array  # (3,)
    angular_acceleration: Array  # (3,) angular acceleration


def interpolate_body(plan: WalkPlan, n: int, time: float) -> PlannedBody:
    """Interpolate the body's motion in the interval from sample n to the next.

    Velocities are linear, and positions consistent with both samples. Slightly outside the
    interval the curves are continued.
    """
    task, state = plan.task, plan.trajectory.state
    span = task.dt
    s = time - n * task.dt
    before, after = state[n], state[n + 1]
    push = plan.loop.push[n + 1] if plan.loop is not None else np.zeros(3)
    # A push changes the velocity at once, not by planned forces
    acceleration = (after[VELOCITY] - push - before[VELOCITY]) / span
    curve = before[POSITION] + s * before[VELOCITY] + 0.5 * s**2 * acceleration
    end = before[POSITION] + span * before[VELOCITY] + 0.5 * span**2 * acceleration
    fraction = s / span
    return PlannedBody(
        position=curve + fraction * (after[POSITION] - end),
        velocity=before[VELOCITY] + s * acceleration,
        acceleration=acceleration,
        rotation=rotation_world_body(before[ANGLES] + fraction * (after[ANGLES] - before[ANGLES])),
        angular_velocity=before[SPIN] + fraction * (after[SPIN] - before[SPIN]),
        angular_acceleration=(after[SPIN] - before[SPIN]) / span,
    )
