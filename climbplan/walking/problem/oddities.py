"""Figures of a walk that hardly fit its robot: legal, as a planner may find a plan all the same.

Speeds are compared by the Froude number v^2 / (g l) with the length l of the legs. Animals begin to
run at about 0.5 and to gallop at 2 to 3 (Alexander, 1989). A far larger one comes of other units,
or of a goal that is too far for its horizon.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import WalkTask

MAX_FROUDE = 20.0
_MAX_HEIGHT_RATIO = 3.0  # of the body above the ground to the length of the legs


def find_oddities(spec: MpcSpec, task: WalkTask) -> tuple[str, ...]:
    """Return one line for each figure that hardly fits the robot, with its key.

    Args:
        spec: Spec of the walk.
        task: The task of this spec.
    """
    return tuple(_find_oddity_lines(spec, task))


def _find_oddity_lines(spec: MpcSpec, task: WalkTask) -> Iterator[str]:
    leg_length = float(-task.body.toe_center[:, 2].min())  # [m] at which the body stands
    if leg_length <= 0:
        return
    max_speed = float(np.sqrt(MAX_FROUDE * task.body.gravity * leg_length))
    name = task.body.name
    reach = f"legs of {name} are {leg_length:.3g} m long"
    speed = float(np.linalg.norm(spec.task.reference.velocity))
    if speed > max_speed:
        yield (
            f"task.reference.velocity: {speed:.4g} m/s, and {reach}: at most about "
            f"{max_speed:.2g} m/s can be meant"
        )
    height = spec.task.reference.height
    if height is not None and height > _MAX_HEIGHT_RATIO * leg_length:
        yield f"task.reference.height: {height:.4g} m, and {reach}; heights are in metres"
    goal = spec.task.goal
    if goal is not None:
        duration = spec.task.knots * spec.task.dt
        distance = float(np.linalg.norm(np.subtract(goal.position, spec.task.start.position[:2])))
        if distance > max_speed * duration:
            yield (
                f"task.goal.position: {distance:.4g} m away, and the horizon is {duration:.3g} s: "
                f"that is {distance / duration:.3g} m/s, and {reach}"
            )
