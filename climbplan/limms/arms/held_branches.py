"""Arms on the straight way of the box: how clear they are, and in which branches they serve it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from climbplan.limms.corridor import Way
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.contact import gap_between, gap_to_blocks, gap_within, link_segments
from climbplan.limms.modules.limbs import limb_angles, limb_points
from climbplan.limms.scene import Array, Scene
from climbplan.limms.statement import Limb


@dataclass(frozen=True)
class HeldTask:
    """What arms are to do: from, to, through which blocks, and whether they throw."""

    start: Array
    goal: Array
    way: Way
    throw: bool
    arrival_speed: float


def way_points(task: HeldTask) -> Array:
    """Start, crossings and goal (n, 3)."""
    return np.vstack([task.start, task.way.crossings, task.goal])


def clearance(scene: Scene, limbs: Sequence[Limb], box: Array, feet: Array, angles: Array) -> Array:
    """Least gap (T) of limbs from solids, boxes, themselves and each other along a path [m].

    box: (T, 3); feet: (T, limbs, 3); angles: (T, limbs, 6).
    """
    radius = scene.module.radius
    gaps = []
    segments = []
    fixed = scene.solids
    if scene.boxes > 1:
        half = scene.box_size[1:] / 2
        centres = scene.box_start[1:]
        fixed = np.concatenate([fixed, np.stack([centres - half, centres + half], axis=1)])
    for i, limb in enumerate(limbs):
        points = limb_points(scene, limb, box, feet[:, i], angles[:, i])
        segments.append(link_segments(points, radius))
        gaps.append(gap_to_blocks(segments[i], fixed[:, 0], fixed[:, 1], radius).min(axis=(1, 2)))
        half = scene.box_size[0] / 2
        low, high = (box - half)[:, None], (box + half)[:, None]
        gaps.append(gap_to_blocks(segments[i], low, high, radius).min(axis=(1, 2)))
        gaps.append(gap_within(segments[i], radius).min(axis=1))
        gaps += [gap_between(segments[i], s, radius).min(axis=(1, 2)) for s in segments[:i]]
    worst: Array = np.min(gaps, axis=0)
    return worst


def branch_choices(
    scene: Scene, limb: Limb, path: Array, feet: Array, most: int = 3
) -> list[tuple[float, Limb]]:
    """The limb with its likeliest branches, best first: feasible at the start, least trouble after.

    path: (T, 3) box centres; feet: (T, 3) other ends.
    """
    found = []
    for branch in BRANCHES:
        angles, missing = limb_angles(scene, limb, path, feet, branch)
        excess = in_range(scene.module, angles)
        gap = clearance(scene, [limb], path, feet[:, None], angles[:, None])
        if missing[0] > 1e-9 or excess[0] > 0 or gap[0] < -1e-4:
            continue
        turning = np.abs(np.diff(angles, axis=0)).max(axis=1).sum() if len(path) > 1 else 0.0
        trouble = (
            10 * missing.max()
            + 3 * max(excess.max(), 0.0)
            + 20 * np.maximum(-gap, 0.0).mean()
            + 0.1 * turning
        )
        found.append((float(trouble), replace(limb, branch=branch)))
    found.sort(key=lambda entry: entry[0])
    return found[:most]


def release_share(scene: Scene, limbs: Sequence[Limb], first: Array, last: Array) -> float:
    """How far along a straight line all arms reach, in any branch."""
    shares = np.linspace(0, 1, 41)
    path = first + shares[:, None] * (last - first)
    ok = np.ones(len(shares), bool)
    for limb in limbs:
        feet = np.broadcast_to(limb.fixed_position, path.shape)
        each = []
        for branch in BRANCHES:
            angles, missing = limb_angles(scene, limb, path, feet, branch)
            each.append((missing <= 0) & (in_range(scene.module, angles) < 0))
        ok &= np.any(each, axis=0)
    bad = np.flatnonzero(~ok)
    return float(shares[bad[0] - 1]) if len(bad) and bad[0] > 0 else float(not len(bad))


def path_choices(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask
) -> list[list[tuple[float, Limb]]]:
    """Likeliest branches of each limb along the straight way, as far as it is not thrown."""
    corners = way_points(task)
    if task.throw:
        share = release_share(scene, limbs, corners[-2], corners[-1])
        corners[-1] = corners[-2] + share * (corners[-1] - corners[-2])
    path = np.vstack(
        [
            first + np.linspace(0, 1, 9)[:, None] * (last - first)
            for first, last in pairwise(corners)
        ]
    )
    return [
        branch_choices(scene, limb, path, np.tile(limb.fixed_position, (len(path), 1)))
        for limb in limbs
    ]


def combinations(
    choices: Sequence[Sequence[tuple[float, Limb]]], most: int = 6
) -> list[tuple[Limb, ...]]:
    """Choices of a branch for each limb, least trouble together first."""
    every = sorted(product(*choices), key=lambda combo: sum(entry[0] for entry in combo))
    return [tuple(entry[1] for entry in combo) for combo in every[:most]]
