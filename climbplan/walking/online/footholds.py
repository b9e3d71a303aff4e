"""Where legs come down online: anywhere on flat ground, else on footholds of its regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.offline.footing import gait_of
from climbplan.walking.offline.gaits import with_regions
from climbplan.walking.offline.pinned import Iterate
from climbplan.walking.online.candidates import flat_gait
from climbplan.walking.problem.problem import ground_under
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import POSITION, Gait, Goal, Start, WalkTask, WalkTrajectory


def grounded(ground: Ground, toes: Array) -> Array:
    """Toes (L, 3) on the nearest footholds; on flat ground straight below."""
    if ground.endless:
        return toes * [1.0, 1.0, 0.0]
    region = ground.nearest(toes[:, :2])
    xy = ground.into(region, toes[:, :2])
    return np.column_stack([xy, ground.level_at(region, xy)])


def gait_on(task: WalkTask, contact: BoolArray, motion: Array | None) -> Gait:
    """A gait with these contacts (N + 1, L), on the regions that legs would best stand on.

    motion: (N + 1, 12) to judge that by; an even one to the reference if None.
    """
    if task.ground.endless:
        return flat_gait(contact)
    return with_regions(task, contact, motion)


def gone_on(task: WalkTask, gait: Gait, at: Iterate, last: WalkTrajectory, kept: int) -> Gait:
    """What is left of a plan on the regions that it chose; what is new on those that fit best.

    kept: rows of the gait that are the plan's own last rows.
    """
    if task.ground.endless:
        return gait
    region = with_regions(task, gait.contact, at.state).region.copy()
    region[1:kept] = last.gait.region[len(last.gait.region) - kept + 1 :]
    return gait_of(gait.contact, region)


def following(task: WalkTask, above: float) -> WalkTask:
    """The task with heights of its reference above the ground along the way from its start.

    above [m]: of the body above the ground under it.
    """
    if task.ground.endless:
        return task
    reference, start = task.reference, task.start.state[POSITION]
    way = start[:2] + np.cumsum(task.steps[:, None] * reference.velocity[:, :2], axis=0)
    below = ground_under(task.ground, task.body, way, reference.euler[0])
    return replace(task, reference=replace(reference, height=above + below))


def on_flat_ground(task: WalkTask) -> WalkTask:
    """The task on flat ground, at rest or not, that libraries are made for."""
    if task.ground.endless:
        return task
    height = height_above(task)
    state, reference = task.start.state.copy(), task.reference
    state[2] = height
    toes = (state[POSITION] + task.body.toe_center) * [1.0, 1.0, 0.0]
    return replace(
        task,
        ground=Ground.flat(task.ground.friction),
        start=Start(state, toes),
        reference=replace(reference, height=np.full(len(reference.height), height)),
        goal=Goal.anywhere(),
    )


def height_above(task: WalkTask) -> float:
    """How high the reference of a spec's task is above the ground under it [m]."""
    if task.ground.endless:
        return float(task.reference.height[-1])
    reference = task.reference
    moved = (task.steps[:, None] * reference.velocity[:, :2]).sum(axis=0)
    way = task.start.state[POSITION][:2] + moved
    below = ground_under(task.ground, task.body, way[None], reference.euler[-1])
    return float(reference.height[-1] - below[0])
