"""Arms on the straight way of the box: how clear they are, and in which branches they serve it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.contact import (
    gap_between,
    gap_to_blocks,
    gap_to_boxes,
    gap_within,
    link_segments,
)
from climbplan.limms.modules.limbs import limb_angles, limb_points
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb
from climbplan.limms.scene.placement import centre_of, yaw_of
from climbplan.limms.schema.module import ModuleSpec

RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] further where latches close
SINGULAR = (0.05, 0.12, 0.08)  # [m], [rad], [rad] that poses keep from where branches meet


@dataclass(frozen=True)
class HeldTask:
    """What arms are to do: from, to, through which blocks, and whether they throw."""

    start: Array  # (D,) placements of the box [m, rad]
    goal: Array  # (D,)
    way: Corridor
    throw: bool
    arrival_speed: float


def way_points(task: HeldTask) -> Array:
    """Start, crossings and goal (n, D)."""
    return np.vstack([task.start, task.way.crossings, task.goal])


def clearance(scene: Scene, limbs: Sequence[Limb], box: Array, feet: Array, angles: Array) -> Array:
    """Least gap (T) of limbs from solids, boxes, themselves and each other along a path [m].

    box: (T, D) placements; feet: (T, limbs, 3); angles: (T, limbs, 6).
    """
    radius = scene.module.radius
    gaps = []
    segments = []
    solids, half = scene.solids, scene.box_size / 2
    others = scene.box_start[1:], scene.start_yaws[1:], half[1:]
    for i, limb in enumerate(limbs):
        points = limb_points(scene, limb, box, feet[:, i], angles[:, i])
        segments.append(link_segments(points, radius))
        gaps.append(gap_to_blocks(segments[i], solids[:, 0], solids[:, 1], radius).min(axis=(1, 2)))
        if scene.num_boxes > 1:
            gaps.append(gap_to_boxes(segments[i], *others, radius).min(axis=(1, 2)))
        own = centre_of(box)[:, None], yaw_of(box)[:, None], half[:1]
        gaps.append(gap_to_boxes(segments[i], *own, radius).min(axis=(1, 2)))
        gaps.append(gap_within(segments[i], radius).min(axis=1))
        gaps += [gap_between(segments[i], s, radius).min(axis=(1, 2)) for s in segments[:i]]
    worst: Array = np.min(gaps, axis=0)
    return worst


def off_singular(module: ModuleSpec, angles: Array) -> BoolArray:
    """Which angles (..., 6) are far enough from poses where branches meet, as programs ask."""
    lean, bend = angles[..., 1], angles[..., 2]
    a = module.link_lengths
    off = np.abs(a[2] * np.sin(lean) + (a[3] + a[4]) * np.sin(lean + bend))
    least, elbow, wrist = SINGULAR
    kept = (off >= least) & (np.abs(bend) >= elbow) & (np.abs(angles[..., 4]) >= wrist)
    return np.asarray(kept)


class Choice(NamedTuple):
    """A limb with a branch, and what speaks against it."""

    rank: int  # among those whose links are in the same places, which differ in rolls only
    trouble: float  # along the way
    limb: Limb


def branch_choices(
    scene: Scene, limb: Limb, path: Array, feet: Array, most: int = 4
) -> list[Choice]:
    """The limb with its likeliest branches, best first: feasible at the start, least trouble after.

    Of those that do not serve the end of the path the others come first, and one of each bend of
    the links comes before another one of the same bend. path: (T, D) of the box; feet: (T, 3)
    other ends.
    """
    found: list[tuple[bool, float, Limb, tuple[float, ...]]] = []
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
        bent = off_singular(scene.module, angles)
        if len(path) > 1 and not bent[0]:
            continue
        ends_badly = missing[-1] > 1e-9 or excess[-1] > 0 or gap[-1] < -1e-4 or not bent[-1]
        bend = limb_points(scene, limb, path[:1], feet[:1], angles[:1]).position[0]
        key = tuple(np.round(bend, 6).ravel() + 0.0)
        found.append((bool(ends_badly), float(trouble), replace(limb, branch=branch), key))
    found.sort(key=lambda entry: entry[:2])
    seen: Counter[tuple[float, ...]] = Counter()
    ranked = []
    for ends_badly, trouble, choice, key in found:
        ranked.append((ends_badly, Choice(seen[key], trouble, choice)))
        seen[key] += 1
    ranked.sort(key=lambda entry: (entry[0], entry[1].rank, entry[1].trouble))
    return [choice for _, choice in ranked[:most]]


def release_share(scene: Scene, limbs: Sequence[Limb], first: Array, last: Array) -> float:
    """How far along a straight line all arms reach, in any branch."""
    shares = np.linspace(0, 1, 41)
    path = first + shares[:, None] * (last - first)
    ok = np.ones(len(shares), bool)
    for limb in limbs:
        feet = np.broadcast_to(limb.fixed_position, (len(path), 3))
        each = []
        for branch in BRANCHES:
            angles, missing = limb_angles(scene, limb, path, feet, branch)
            each.append((missing <= 0) & (in_range(scene.module, angles) < 0))
        ok &= np.any(each, axis=0)
    bad = np.flatnonzero(~ok)
    return float(shares[bad[0] - 1]) if len(bad) and bad[0] > 0 else float(not len(bad))


def path_choices(scene: Scene, limbs: Sequence[Limb], task: HeldTask) -> list[list[Choice]]:
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


def combinations(choices: Sequence[Sequence[Choice]], most: int = 6) -> list[tuple[Limb, ...]]:
    """Choices of a branch for each limb, other bends before other rolls, least trouble first."""
    every = sorted(
        product(*choices),
        key=lambda combo: (sum(c.rank for c in combo), sum(c.trouble for c in combo)),
    )
    return [tuple(c.limb for c in combo) for combo in every[:most]]
