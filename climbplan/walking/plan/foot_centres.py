"""Walks on spherical feet: planned by the centres of feet, told in the world of the ground.

Every method places toes, points on the planes of the ground. Of a spherical foot that point is its
centre, which stands its radius off the ground, along the normal. Planes in tasks are therefore
those of centres, as far as planning goes shifted to the ground's own height; `raised` moves what
was planned up by the radius, after which `Ground.standoff` off its planes is the ground as stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import POSITION, WalkTask

_UP = np.array([0.0, 0.0, 1.0])


def steepness(slope: Array) -> Array:
    """Return how much farther apart planes (..., 2) are along z than along their normals (...)."""
    return np.asarray(np.sqrt(1.0 + (slope**2).sum(axis=-1)))


def on_centres(ground: Ground, radius: float) -> Ground:
    """Return the planes of the centres of feet of a radius [m], all lowered by that radius."""
    rise = radius * (steepness(ground.slope) - 1.0)
    return replace(ground, height=ground.height + rise, standoff=radius)


def material(ground: Ground) -> Ground:
    """Return the ground that feet touch, of planes that were raised."""
    below = ground.standoff * steepness(ground.slope)
    return replace(ground, height=ground.height - below, standoff=0.0)


def raised_task(task: WalkTask, rise: float) -> WalkTask:
    """Return a task with ground, start and heights so much higher [m]."""
    return replace(
        task,
        ground=replace(task.ground, height=task.ground.height + rise),
        start=replace(
            task.start,
            state=_higher(task.start.state, rise),
            toes=task.start.toes + rise * _UP,
        ),
        reference=replace(task.reference, height=task.reference.height + rise),
    )


def raised(plan: WalkPlan) -> WalkPlan:
    """Return a plan by centres of feet on the ground as stated: all of it up by their radius."""
    rise = plan.task.ground.standoff
    if rise == 0:
        return plan
    found = plan.trajectory
    return replace(
        plan,
        task=raised_task(plan.task, rise),
        trajectory=replace(found, state=_higher(found.state, rise), toes=found.toes + rise * _UP),
        begun=None if plan.begun is None else _higher(plan.begun, rise),
    )


def _higher(state: Array, rise: float) -> Array:
    """States (..., 12) with positions so much higher [m]."""
    out = state.copy()
    out[..., POSITION] += rise * _UP
    return out
