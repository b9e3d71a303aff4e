"""World axes of walks: x forward, in which they are planned, and y forward as in climbs.

A walk of a spec with `forward: y` is planned with x forward, and its result is turned by a quarter
about z. The body frame of walks stays x forward, y left, z up, so that a body that faces forward
has a yaw of a right angle in the axes of climbs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.plan.walk_plan import Forward, WalkPlan
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    VELOCITY,
    Goal,
    WalkTask,
)


def to_walking_axes(vectors: Array) -> Array:
    """Return world vectors (..., 2) or (..., 3) with y forward in axes with x forward."""
    result = np.array(vectors, float)
    result[..., 0], result[..., 1] = vectors[..., 1], -vectors[..., 0]
    return result


def to_climbing_axes(vectors: Array) -> Array:
    """Return world vectors (..., 2) or (..., 3) with x forward in axes with y forward."""
    result = np.array(vectors, float)
    result[..., 0], result[..., 1] = -vectors[..., 1], vectors[..., 0]
    return result


def turn_ground_to_walking(ground: Ground) -> Ground:
    """Return the regions and scan of axes with y forward in axes with x forward."""
    lower = np.column_stack([ground.lower[:, 1], -ground.upper[:, 0]])
    upper = np.column_stack([ground.upper[:, 1], -ground.lower[:, 0]])
    scan = ground.scan
    return replace(
        ground,
        lower=lower,
        upper=upper,
        slope=to_walking_axes(ground.slope),
        corners=to_walking_axes(ground.corners),
        scan=None if scan is None else replace(scan, vertices=to_walking_axes(scan.vertices)),
    )


def _turn_ground_to_climbing(ground: Ground) -> Ground:
    """Return the regions and scan of axes with x forward in axes with y forward."""
    lower = np.column_stack([-ground.upper[:, 1], ground.lower[:, 0]])
    upper = np.column_stack([-ground.lower[:, 1], ground.upper[:, 0]])
    scan = ground.scan
    return replace(
        ground,
        lower=lower,
        upper=upper,
        slope=to_climbing_axes(ground.slope),
        corners=to_climbing_axes(ground.corners),
        scan=None if scan is None else replace(scan, vertices=to_climbing_axes(scan.vertices)),
    )


def orient_task(task: WalkTask, forward: Forward) -> WalkTask:
    """Return a task with x forward in the axes of its spec."""
    if forward == "x":
        return task
    reference, weights, goal = task.reference, task.weights, task.goal
    lower = np.array([-goal.upper[1], goal.lower[0]])
    upper = np.array([-goal.lower[1], goal.upper[0]])
    return replace(
        task,
        ground=_turn_ground_to_climbing(task.ground),
        start=replace(
            task.start,
            state=_turn_states(task.start.state),
            toes=to_climbing_axes(task.start.toes),
        ),
        reference=replace(
            reference,
            velocity=to_climbing_axes(reference.velocity),
            euler=_turn_angles(reference.euler),
        ),
        weights=replace(weights, velocity=weights.velocity[[1, 0, 2]]),
        goal=Goal(lower, upper),
    )


def orient_plan(plan: WalkPlan, forward: Forward) -> WalkPlan:
    """Return a plan with x forward in the axes of its spec."""
    if forward == "x":
        return plan
    trajectory, loop = plan.trajectory, plan.loop
    initial = plan.initial_states
    return replace(
        plan,
        forward=forward,
        task=orient_task(plan.task, forward),
        trajectory=replace(
            trajectory,
            state=_turn_states(trajectory.state),
            toes=to_climbing_axes(trajectory.toes),
            force=to_climbing_axes(trajectory.force),
        ),
        initial_states=None if initial is None else _turn_states(initial),
        loop=None if loop is None else replace(loop, push=to_climbing_axes(loop.push)),
    )


def _turn_states(state: Array) -> Array:
    """Return states (..., 12) with x forward in axes with y forward."""
    result = state.copy()
    for component in (POSITION, VELOCITY, SPIN):
        result[..., component] = to_climbing_axes(state[..., component])
    result[..., ANGLES] = _turn_angles(state[..., ANGLES])
    return result


def _turn_angles(angles: Array) -> Array:
    """Return roll, pitch and yaw (..., 3) of a body in a world that is turned by a quarter."""
    result = angles.copy()
    result[..., 2] += 0.5 * np.pi
    return result
