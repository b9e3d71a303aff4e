"""The box as body of a quadruped: where its legs may stand when they latch to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from climbplan.limms.chain import BRANCHES, in_range
from climbplan.limms.corridor import Way
from climbplan.limms.footholds import PATCH_MARGIN
from climbplan.limms.gaits import Gait
from climbplan.limms.held import clearance
from climbplan.limms.limbs import leg, limb_angles
from climbplan.limms.scene import SIDE_NORMALS, Array, Scene
from climbplan.limms.statement import Limb

_SIDEWAYS = (-0.3, -0.15, 0.0, 0.15, 0.3)
_AWAY = (0.3, 0.38, 0.46, 0.54, 0.62)


@dataclass(frozen=True)
class Stand:
    """How a leg may stand while the box rests: foothold, branch, how well."""

    side: int
    foot: Array  # (3,) [m]
    patch: int
    branch: tuple[int, int, int]
    trouble: float


def first_stands(
    scene: Scene, side: int, start: Array, toward: Array, most: int = 3
) -> list[Stand]:
    """Footholds from which a module latches to a side of the box at rest, best first.

    toward: (n, 3) centres of the box later on, which count as trouble where they are out of reach.
    """
    normal = SIDE_NORMALS[side]
    along = np.array([-normal[1], normal[0], 0.0])
    half = abs(normal) @ scene.box_size[0] / 2
    limb = leg(0, side, 1, BRANCHES[0])
    found = []
    path = np.vstack([start, toward])
    for k, patch in enumerate(scene.patches):
        points = np.array(
            [
                start + (half + away) * normal + sideways * along
                for away in _AWAY
                for sideways in _SIDEWAYS
            ]
        )
        # Also where the patch is nearest
        near = np.clip(points[:, :2], patch.lower + PATCH_MARGIN, patch.upper - PATCH_MARGIN)
        points = np.unique(
            np.round(np.column_stack([near, np.full(len(near), patch.height)]), 4), axis=0
        )
        for point in points:
            if not patch.inside(point, PATCH_MARGIN - 1e-6):
                continue
            if normal @ (point - start) < half + 0.02:
                continue  # a foot stands on its own side of the box
            for branch in BRANCHES:
                angles, missing = limb_angles(
                    scene, limb, path, np.tile(point, (len(path), 1)), branch
                )
                excess = in_range(scene.module, angles)
                if (missing[0] > -1e-9 and missing[0] > 0) or excess[0] > -0.03:
                    continue
                feet = np.tile(point, (len(path), 1, 1))
                gap = clearance(scene, [limb], path, feet, angles[:, None])
                if gap[0] < -1e-9:
                    continue
                trouble = (
                    5 * missing.sum() + np.maximum(excess, 0).sum() + 20 * np.maximum(-gap, 0).sum()
                )
                nominal = abs(np.linalg.norm(point[:2] - start[:2]) - half - 0.45)
                found.append(Stand(side, point, k, branch, float(trouble + 0.3 * nominal)))
    found.sort(key=lambda s: s.trouble)
    kept: list[Stand] = []
    for stand in found:
        if all(np.linalg.norm(stand.foot - k.foot) > 0.1 or stand.branch != k.branch for k in kept):
            kept.append(stand)
    return kept[:most]


def legs_of(stands: Sequence[Stand]) -> tuple[Limb, ...]:
    """Legs that stand on first footholds; module numbers are those of the stands' order."""
    return tuple(leg(i, s.side, 1, s.branch) for i, s in enumerate(stands))


def first_stand_sets(scene: Scene, gait: Gait, way: Way, most: int) -> Iterator[tuple[Stand, ...]]:
    """Sets of first footholds, least trouble first, that do not stand on each other."""
    start = scene.box_start[0]
    if gait.steps == 0:
        toward = np.vstack([way.crossings, scene.goal])
    else:
        toward = (start + np.array([0, 0, 0.15]))[None]
    choices = [first_stands(scene, side, start, toward) for side in range(4)]
    ranked = sorted(product(*choices), key=lambda stands: sum(s.trouble for s in stands))
    count = 0
    for stands in ranked:
        feet = np.array([s.foot for s in stands])
        apart = np.linalg.norm(feet[:, None] - feet[None], axis=-1) + np.eye(len(feet))
        if apart.min() < 0.15:
            continue
        yield tuple(stands)
        count += 1
        if count >= most:
            return
