"""The box as body of a quadruped: where its legs may stand when they latch to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.arms.held_branches import clearance
from climbplan.limms.legs.footholds import PATCH_MARGIN
from climbplan.limms.legs.gaits import Gait
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.limbs import leg, limb_angles
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, Scene
from climbplan.limms.scene.phases import Limb

_SIDEWAYS = np.linspace(-0.45, 0.45, 7)
_AWAY = np.linspace(0.03, 0.75, 10)
_NOMINAL = 0.4  # [m] of a foot from its face of the box
_APART = 0.1  # [m] between footholds that are told apart
_CHOICES = 10  # of a leg
_POINTS = 5  # of each straight piece of the way that are looked at
_CLEAR = 0.01  # [m] off everything
_RANGE = 0.1  # [rad]
_CLOSING = 0.18  # [rad] where the latches close
_LEGS_APART = 0.2  # [m] between the feet of two legs


@dataclass(frozen=True)
class Stand:
    """How a leg may stand while the box rests: foothold, branch, how well."""

    side: int
    foot: Array  # (3,) [m]
    patch: int
    branch: tuple[int, int, int]
    trouble: float


def first_stands(scene: Scene, side: int, path: Array, most: int = _CHOICES) -> list[Stand]:
    """Footholds from which a module latches to a side of the box at rest, best first.

    path: (n, 3) centres of the box, the one at rest first; later ones count as trouble where they
    are out of reach or where the leg touches something.
    """
    normal = SIDE_NORMALS[side]
    along = np.array([-normal[1], normal[0], 0.0])
    half = float(abs(normal) @ scene.box_size[0] / 2)
    ahead = float((path @ normal).max())  # a foot stands on its own side of the box all the way
    shift = (path[0] + path[-1]) / 2
    grid = np.array([a * normal + s * along for a in _AWAY for s in _SIDEWAYS])
    grid += shift + (ahead + half - shift @ normal) * normal
    found = []
    for k, patch in enumerate(scene.patches):
        feet = np.column_stack([grid[:, :2], np.full(len(grid), patch.height)])
        for foot in feet[patch.contains(feet, PATCH_MARGIN)]:
            best = _best_branch(scene, side, foot, path)
            if best is not None:
                trouble, branch = best
                nominal = float(np.linalg.norm((foot - shift - (half + _NOMINAL) * normal)[:2]))
                found.append(Stand(side, foot, k, branch, trouble + 0.1 * nominal))
    found.sort(key=lambda stand: stand.trouble)
    kept: list[Stand] = []
    for stand in found:
        if all(np.linalg.norm(stand.foot - other.foot) > _APART for other in kept):
            kept.append(stand)
    return kept[:most]


def _best_branch(
    scene: Scene, side: int, foot: Array, path: Array
) -> tuple[float, tuple[int, int, int]] | None:
    """Least trouble of a foothold, and the branch that has it; None if no latch closes there."""
    best: tuple[float, tuple[int, int, int]] | None = None
    feet = np.tile(foot, (len(path), 1))
    for branch in BRANCHES:
        limb = leg(0, side, 1, branch)
        angles, missing = limb_angles(scene, limb, path, feet, branch)
        excess = in_range(scene.module, angles)
        if missing[0] > 0 or excess[0] > -_CLOSING:
            continue
        reach = 5 * missing.sum() + np.maximum(excess + _RANGE, 0).sum()
        if best is not None and reach > best[0]:
            continue
        gap = clearance(scene, [limb], path, feet[:, None], angles[:, None])
        if gap[0] < -1e-9:
            continue
        trouble = float(reach + 20 * np.maximum(_CLEAR - gap[1:], 0).sum())
        if best is None or trouble < best[0]:
            best = trouble, branch
    return best


def legs_of(stands: Sequence[Stand]) -> tuple[Limb, ...]:
    """Legs that stand on first footholds; module numbers are those of the stands' order."""
    return tuple(leg(i, s.side, 1, s.branch) for i, s in enumerate(stands))


def first_stand_sets(
    scene: Scene, gait: Gait, way: Corridor, most: int
) -> Iterator[tuple[Stand, ...]]:
    """Sets of first footholds that carry the box, least trouble and load first."""
    start = scene.box_start[0]
    if gait.steps == 0:
        corners = np.vstack([start, way.crossings, scene.goal])
    else:
        corners = np.vstack([start, start + np.array([0, 0, 0.15])])
    shares = np.linspace(0, 1, _POINTS)[:, None]
    path = np.vstack([a + shares * (b - a) for a, b in pairwise(corners)])
    choices = [first_stands(scene, side, path) for side in range(4)]
    if not all(choices):
        return
    sets = np.array(list(product(*(range(len(c)) for c in choices))))
    feet = np.stack(
        [np.array([s.foot for s in c])[sets[:, i]] for i, c in enumerate(choices)], axis=1
    )
    trouble = sum(np.array([s.trouble for s in c])[sets[:, i]] for i, c in enumerate(choices))
    load = np.max([largest_share(feet, p) for p in corners], axis=0)
    apart = np.min(
        [np.linalg.norm(feet[:, i] - feet[:, j], axis=-1) for i, j in combinations(range(4), 2)],
        axis=0,
    )
    limit = scene.module.max_force / scene.weight
    score = trouble + 5 * np.maximum(load - 0.9 * limit, 0) / limit
    score = np.where((apart < _LEGS_APART) | ~enough_modules(scene, feet), np.inf, score)
    for k in np.argsort(score)[:most]:
        if np.isfinite(score[k]):
            yield tuple(c[j] for c, j in zip(choices, sets[k], strict=True))


def enough_modules(scene: Scene, feet: Array) -> BoolArray:
    """Whether as many modules stand on each level as feet (n, 4, 3) need: they do not climb."""
    stand = scene.start_position[scene.start_anchor < 0, 2]
    fits = np.ones(len(feet), bool)
    for height in np.unique(feet[..., 2]):
        there = int((np.abs(stand - height) < 1e-6).sum())
        fits &= (np.abs(feet[..., 2] - height) < 1e-6).sum(axis=1) <= there
    return fits


def largest_share(feet: Array, box: Array) -> Array:
    """Largest share (n) of the box's weight on one of four feet (n, 4, 3), at least.

    Upright forces that balance weight and moment have one freedom left; it is used to make the
    largest force least.
    """
    x, y = feet[..., 0] - box[0], feet[..., 1] - box[1]
    rows = np.stack([np.ones_like(x), x, y], axis=1)  # (n, 3, 4)
    some = (np.linalg.pinv(rows) @ np.array([1.0, 0, 0])[:, None])[..., 0]
    free = np.stack(
        [(-1) ** i * np.linalg.det(rows[:, :, [j for j in range(4) if j != i]]) for i in range(4)],
        axis=-1,
    )
    # The least largest force is where two are equal or where one vanishes
    lines = [
        (some[:, j] - some[:, i], free[:, i] - free[:, j]) for i, j in combinations(range(4), 2)
    ]
    lines += [(-some[:, i], free[:, i]) for i in range(4)]
    best = np.full(len(feet), np.inf)
    for offset, slope in lines:
        safe = np.where(np.abs(slope) > 1e-9, slope, np.inf)
        force = some + (offset / safe)[:, None] * free
        best = np.minimum(best, np.where(force.min(axis=1) < -1e-9, np.inf, force.max(axis=1)))
    return best
