"""Spherical feet: planning with foot centres, and the conversion back to the terrain's surface.

Every method places toes as points on the terrain's planes. For a spherical foot the point is its
centre, at a distance of its radius along the normal. Tasks therefore have the planes of foot
centres, lowered to the terrain's own height while planning. `raise_plan` raises a result by the
radius; the terrain itself is then `Ground.standoff` below its planes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.ground import Ground, raise_scan
from climbplan.walking.task.task import POSITION, WalkTask

_UP = np.array([0.0, 0.0, 1.0])


def compute_steepness(slope: Array) -> Array:
    """Return the ratio (...) of vertical to normal distance of planes with slope (..., 2)."""
    return np.asarray(np.sqrt(1.0 + (slope**2).sum(axis=-1)))


def shift_to_foot_centres(ground: Ground, radius: float) -> Ground:
    """Return the planes of foot centres for a radius [m], all lowered by that radius."""
    rise = radius * (compute_steepness(ground.slope) - 1.0)
    return replace(ground, height=ground.height + rise, standoff=radius)


def restore_surface(ground: Ground) -> Ground:
    """Return the surface that feet touch, from the planes of raised foot centres."""
    below = ground.standoff * compute_steepness(ground.slope)
    lowered = _raise_ground(ground, -ground.standoff)
    return replace(lowered, height=ground.height - below, standoff=0.0)


def _raise_ground(ground: Ground, rise: float) -> Ground:
    """Return the planes raised [m], with the raw surface of a scan."""
    scan = None if ground.scan is None else raise_scan(ground.scan, rise)
    return replace(ground, height=ground.height + rise, scan=scan)


def raise_task(task: WalkTask, rise: float) -> WalkTask:
    """Return a task with terrain, start and heights raised [m]."""
    return replace(
        task,
        ground=_raise_ground(task.ground, rise),
        start=replace(
            task.start,
            state=_raise_states(task.start.state, rise),
            toes=task.start.toes + rise * _UP,
        ),
        reference=replace(task.reference, height=task.reference.height + rise),
    )


def raise_plan(plan: WalkPlan) -> WalkPlan:
    """Return a plan raised by the radius of its feet, with foot centres above the terrain."""
    rise = plan.task.ground.standoff
    if rise == 0:
        return plan
    trajectory = plan.trajectory
    return replace(
        plan,
        task=raise_task(plan.task, rise),
        trajectory=replace(
            trajectory,
            state=_raise_states(trajectory.state, rise),
            toes=trajectory.toes + rise * _UP,
        ),
        initial_states=(
            None if plan.initial_states is None else _raise_states(plan.initial_states, rise)
        ),
    )


def _raise_states(state: Array, rise: float) -> Array:
    """Return states (..., 12) with raised positions [m]."""
    raised = state.copy()
    raised[..., POSITION] += rise * _UP
    return raised
