"""Foothold selection of the online planner: anywhere on flat ground, else in regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.offline.fixed_contact_qp import WalkIterate
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.gaits import assign_regions
from climbplan.walking.online.gait_adaptation import build_flat_gait
from climbplan.walking.problem.problem import compute_ground_height
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import POSITION, Gait, Goal, Start, WalkTask, WalkTrajectory


def project_to_footholds(ground: Ground, toes: Array) -> Array:
    """Return toes (L, 3) projected to the nearest footholds; on flat ground straight down."""
    if ground.is_flat_everywhere:
        return toes * [1.0, 1.0, 0.0]
    region = ground.nearest(toes[:, :2])
    xy = ground.project(region, toes[:, :2])
    return np.column_stack([xy, ground.compute_height(region, xy)])


def build_terrain_gait(task: WalkTask, contact: BoolArray, states: Array | None) -> Gait:
    """Return the gait of contacts (N + 1, L) with the best-fitting region of each stance.

    Args:
        task: the walking task.
        contact: (N + 1, L) contacts.
        states: (N + 1, 12) body motion for the fit; None for uniform motion to the reference.
    """
    if task.ground.is_flat_everywhere:
        return build_flat_gait(contact)
    return assign_regions(task, contact, states)


def continue_regions(
    task: WalkTask, gait: Gait, iterate: WalkIterate, previous_plan: WalkTrajectory, num_shared: int
) -> Gait:
    """Return a shifted gait with the previous plan's regions and best-fitting ones for new stances.

    Args:
        task: the walking task.
        gait: contacts of the shifted plan.
        iterate: the shifted plan.
        previous_plan: the plan before the shift.
        num_shared: first rows of the gait that are the previous plan's last rows.
    """
    if task.ground.is_flat_everywhere:
        return gait
    region = assign_regions(task, gait.contact, iterate.state).region.copy()
    region[1:num_shared] = previous_plan.gait.region[
        len(previous_plan.gait.region) - num_shared + 1 :
    ]
    return build_gait(gait.contact, region)


def follow_terrain(task: WalkTask, clearance: float) -> WalkTask:
    """Return the task with reference heights above the terrain along the predicted path.

    Args:
        task: the walking task.
        clearance: height of the body above the ground [m].
    """
    if task.ground.is_flat_everywhere:
        return task
    reference, start = task.reference, task.start.state[POSITION]
    path = start[:2] + np.cumsum(task.steps[:, None] * reference.velocity[:, :2], axis=0)
    terrain_height = compute_ground_height(task.ground, task.body, path, reference.euler[0])
    return replace(task, reference=replace(reference, height=clearance + terrain_height))


def flatten_task(task: WalkTask) -> WalkTask:
    """Return the task on flat ground, for which libraries are built."""
    if task.ground.is_flat_everywhere:
        return task
    height = compute_reference_clearance(task)
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


def compute_reference_clearance(task: WalkTask) -> float:
    """Return the height of a spec's reference above the ground under it [m]."""
    if task.ground.is_flat_everywhere:
        return float(task.reference.height[-1])
    reference = task.reference
    displacement = (task.steps[:, None] * reference.velocity[:, :2]).sum(axis=0)
    end_point = task.start.state[POSITION][:2] + displacement
    terrain_height = compute_ground_height(
        task.ground, task.body, end_point[None], reference.euler[-1]
    )
    return float(reference.height[-1] - terrain_height[0])
