"""Arms on the straight path of the box: clearance, and the feasible branches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import BRANCHES, range_excess
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.modules.limbs import compute_limb_angles, compute_limb_points
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule
from climbplan.limms.scene.placement import centre_of, yaw_of
from climbplan.limms.schema.module import ModuleSpec

RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] of additional margin where latches close
SINGULAR_MARGINS = (
    0.05,
    0.12,
    0.08,
)  # [m], [rad], [rad] between poses and singularities, where branches meet


@dataclass(frozen=True)
class HeldTask:
    """The task of arms: from start to goal through a corridor, carrying or throwing."""

    start: Array  # (D,) placements of the box [m, rad]
    goal: Array  # (D,)
    corridor: Corridor
    throw: bool
    arrival_speed: float


def list_way_points(task: HeldTask) -> Array:
    """Return start, crossings and goal (n, D) [m, rad]."""
    return np.vstack([task.start, task.corridor.crossings, task.goal])


def compute_clearance(
    scene: ModuleScene, limbs: Sequence[SupportModule], box: Array, feet: Array, angles: Array
) -> Array:
    """Return the least gap (T,) of limbs from solids, boxes, themselves and each other [m].

    Args:
        scene: The scene.
        limbs: The limbs.
        box: Placements of the box (T, D) [m, rad].
        feet: Far ends of the limbs (T, limbs, 3) [m].
        angles: Joint angles (T, limbs, 6) [rad].
    """
    radius = scene.module.radius
    gaps = []
    segments = []
    solids, half = scene.solids, scene.box_size / 2
    other_boxes = scene.box_start[1:], scene.start_yaws[1:], half[1:]
    for i, limb in enumerate(limbs):
        points = compute_limb_points(scene, limb, box, feet[:, i], angles[:, i])
        segments.append(link_segments(points, radius))
        gaps.append(gap_to_blocks(segments[i], solids[:, 0], solids[:, 1], radius).min(axis=(1, 2)))
        if scene.num_boxes > 1:
            gaps.append(gap_to_boxes(segments[i], *other_boxes, radius).min(axis=(1, 2)))
        moved_box = centre_of(box)[:, None], yaw_of(box)[:, None], half[:1]
        gaps.append(gap_to_boxes(segments[i], *moved_box, radius).min(axis=(1, 2)))
        gaps.append(gap_within(segments[i], radius).min(axis=1))
        gaps += [gap_between(segments[i], s, radius).min(axis=(1, 2)) for s in segments[:i]]
    smallest: Array = np.min(gaps, axis=0)
    return smallest


def is_off_singular(module: ModuleSpec, angles: Array) -> BoolArray:
    """Return which angles (..., 6) keep their distance from singular poses, bool (...)."""
    shoulder, bend = angles[..., 1], angles[..., 2]
    a = module.link_lengths
    axis_distance = np.abs(a[2] * np.sin(shoulder) + (a[3] + a[4]) * np.sin(shoulder + bend))
    min_distance, elbow, wrist = SINGULAR_MARGINS
    is_regular = (
        (axis_distance >= min_distance)
        & (np.abs(bend) >= elbow)
        & (np.abs(angles[..., 4]) >= wrist)
    )
    return np.asarray(is_regular)


class BranchChoice(NamedTuple):
    """A limb with a branch, and its cost."""

    rank: int  # among branches with the same link positions, which differ in rolls only
    cost: float  # along the path
    limb: SupportModule


def rank_branches(
    scene: ModuleScene, limb: SupportModule, path: Array, feet: Array, max_branches: int = 4
) -> list[BranchChoice]:
    """Return the limb in its best branches: feasible at the start, cheapest along the path.

    Branches infeasible at the end come last. One branch of each link position comes before others
    with the same position.

    Args:
        scene: The scene.
        limb: The limb.
        path: Placements of the box (T, D) [m, rad].
        feet: Far end of the limb (T, 3) [m].
        max_branches: Largest number of branches.
    """
    candidates: list[tuple[bool, float, SupportModule, tuple[float, ...]]] = []
    for branch in BRANCHES:
        angles, reach_error = compute_limb_angles(scene, limb, path, feet, branch)
        excess = range_excess(scene.module, angles)
        gap = compute_clearance(scene, [limb], path, feet[:, None], angles[:, None])
        if reach_error[0] > 1e-9 or excess[0] > 0 or gap[0] < -1e-4:
            continue
        travel = np.abs(np.diff(angles, axis=0)).max(axis=1).sum() if len(path) > 1 else 0.0
        cost = (
            10 * reach_error.max()
            + 3 * max(excess.max(), 0.0)
            + 20 * np.maximum(-gap, 0.0).mean()
            + 0.1 * travel
        )
        is_regular = is_off_singular(scene.module, angles)
        if len(path) > 1 and not is_regular[0]:
            continue
        ends_badly = (
            reach_error[-1] > 1e-9 or excess[-1] > 0 or gap[-1] < -1e-4 or not is_regular[-1]
        )
        link_points = compute_limb_points(scene, limb, path[:1], feet[:1], angles[:1]).position[0]
        key = tuple(np.round(link_points, 6).ravel() + 0.0)
        candidates.append((bool(ends_badly), float(cost), replace(limb, branch=branch), key))
    candidates.sort(key=lambda entry: entry[:2])
    num_of_bend: Counter[tuple[float, ...]] = Counter()
    ranked = []
    for ends_badly, cost, choice, key in candidates:
        ranked.append((ends_badly, BranchChoice(num_of_bend[key], cost, choice)))
        num_of_bend[key] += 1
    ranked.sort(key=lambda entry: (entry[0], entry[1].rank, entry[1].cost))
    return [choice for _, choice in ranked[:max_branches]]


def compute_release_fraction(
    scene: ModuleScene, limbs: Sequence[SupportModule], first: Array, last: Array
) -> float:
    """Return the fraction of a straight line that all arms reach, in any branch."""
    fractions = np.linspace(0, 1, 41)
    path = first + fractions[:, None] * (last - first)
    is_reached = np.ones(len(fractions), bool)
    for limb in limbs:
        feet = np.broadcast_to(limb.fixed_position, (len(path), 3))
        by_branch = []
        for branch in BRANCHES:
            angles, reach_error = compute_limb_angles(scene, limb, path, feet, branch)
            by_branch.append((reach_error <= 0) & (range_excess(scene.module, angles) < 0))
        is_reached &= np.any(by_branch, axis=0)
    unreached = np.flatnonzero(~is_reached)
    return (
        float(fractions[unreached[0] - 1])
        if len(unreached) and unreached[0] > 0
        else float(not len(unreached))
    )


def rank_branches_on_path(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask
) -> list[list[BranchChoice]]:
    """Return the best branches of each limb along the straight path, up to a release."""
    corners = list_way_points(task)
    if task.throw:
        fraction = compute_release_fraction(scene, limbs, corners[-2], corners[-1])
        corners[-1] = corners[-2] + fraction * (corners[-1] - corners[-2])
    path = np.vstack(
        [
            first + np.linspace(0, 1, 9)[:, None] * (last - first)
            for first, last in pairwise(corners)
        ]
    )
    return [
        rank_branches(scene, limb, path, np.tile(limb.fixed_position, (len(path), 1)))
        for limb in limbs
    ]


def combine_choices(
    choices: Sequence[Sequence[BranchChoice]], max_combinations: int = 6
) -> list[tuple[SupportModule, ...]]:
    """Return combinations of branches, other link positions before other rolls, cheapest first."""
    ranked = sorted(
        product(*choices),
        key=lambda choice: (
            sum(branch.rank for branch in choice),
            sum(branch.cost for branch in choice),
        ),
    )
    return [tuple(branch.limb for branch in choice) for choice in ranked[:max_combinations]]
