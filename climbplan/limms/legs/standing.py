"""The box as the body of a quadruped: footholds from which modules latch to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.arms.branch_choices import compute_clearance
from climbplan.limms.legs.footholds import PATCH_MARGIN
from climbplan.limms.legs.gaits import SwingPattern
from climbplan.limms.modules.chain import BRANCHES, range_excess
from climbplan.limms.modules.limbs import build_leg, compute_limb_angles
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, ModuleScene
from climbplan.limms.scene.phases import SupportModule

_LATERAL_OFFSETS = np.linspace(-0.45, 0.45, 7)
_DISTANCES = np.linspace(0.03, 0.75, 10)
_NOMINAL_DISTANCE = 0.4  # [m] of a foot from its face of the box
_MIN_SPACING = 0.1  # [m] between distinct footholds
_MAX_CHOICES = 10  # stances of a leg
_NUM_POINTS = 5  # test points on each straight piece of the path
_CLEARANCE = 0.01  # [m] from everything
_RANGE_MARGIN = 0.1  # [rad]
_APPROACH_MARGIN = 0.18  # [rad] where latches close
_MIN_FOOT_DISTANCE = 0.2  # [m] between the feet of two legs


@dataclass(frozen=True)
class FootStance:
    """A stance of a leg while the box rests: foothold, branch and cost."""

    side: int
    foot: Array  # (3,) [m]
    patch: int
    branch: tuple[int, int, int]
    cost: float


def find_stances(
    scene: ModuleScene, side: int, path: Array, max_stances: int = _MAX_CHOICES
) -> list[FootStance]:
    """Return stances from which a module latches to a side of the box at rest, best first.

    Args:
        scene: The scene.
        side: Side of the box.
        path: Centres of the box (n, 3), the one at rest first. Later ones add cost where they are
            out
            of reach or the leg collides.
        max_stances: Largest number of stances.
    """
    normal = SIDE_NORMALS[side]
    lateral = np.array([-normal[1], normal[0], 0.0])
    half = float(abs(normal) @ scene.box_size[0] / 2)
    furthest = float((path @ normal).max())  # a foot stays on its side of the box along the path
    shift = (path[0] + path[-1]) / 2
    grid = np.array([a * normal + s * lateral for a in _DISTANCES for s in _LATERAL_OFFSETS])
    grid += shift + (furthest + half - shift @ normal) * normal
    stances = []
    for k, patch in enumerate(scene.patches):
        feet = np.column_stack([grid[:, :2], np.full(len(grid), patch.height)])
        for foot in feet[patch.contains(feet, PATCH_MARGIN)]:
            choice = _select_branch(scene, side, foot, path)
            if choice is not None:
                cost, branch = choice
                nominal = float(
                    np.linalg.norm((foot - shift - (half + _NOMINAL_DISTANCE) * normal)[:2])
                )
                stances.append(FootStance(side, foot, k, branch, cost + 0.1 * nominal))
    stances.sort(key=lambda stand: stand.cost)
    selected: list[FootStance] = []
    for stand in stances:
        if all(np.linalg.norm(stand.foot - earlier.foot) > _MIN_SPACING for earlier in selected):
            selected.append(stand)
    return selected[:max_stances]


def _select_branch(
    scene: ModuleScene, side: int, foot: Array, path: Array
) -> tuple[float, tuple[int, int, int]] | None:
    """Return least cost and branch of a foothold; None if no latch closes there."""
    best: tuple[float, tuple[int, int, int]] | None = None
    feet = np.tile(foot, (len(path), 1))
    for branch in BRANCHES:
        limb = build_leg(0, side, 1, branch)
        angles, reach_error = compute_limb_angles(scene, limb, path, feet, branch)
        excess = range_excess(scene.module, angles)
        if reach_error[0] > 0 or excess[0] > -_APPROACH_MARGIN:
            continue
        reach_cost = 5 * reach_error.sum() + np.maximum(excess + _RANGE_MARGIN, 0).sum()
        if best is not None and reach_cost > best[0]:
            continue
        gap = compute_clearance(scene, [limb], path, feet[:, None], angles[:, None])
        if gap[0] < -1e-9:
            continue
        cost = float(reach_cost + 20 * np.maximum(_CLEARANCE - gap[1:], 0).sum())
        if best is None or cost < best[0]:
            best = cost, branch
    return best


def build_legs(stances: Sequence[FootStance]) -> tuple[SupportModule, ...]:
    """Return legs in these stances; modules are numbered by their order."""
    return tuple(build_leg(i, s.side, 1, s.branch) for i, s in enumerate(stances))


def find_stance_sets(
    scene: ModuleScene, gait: SwingPattern, corridor: Corridor, max_sets: int
) -> Iterator[tuple[FootStance, ...]]:
    """Yield sets of stances that carry the box, those of least cost and load first."""
    start = scene.box_start[0]
    if gait.steps == 0:
        corners = np.vstack([start, corridor.crossings, scene.goal])
    else:
        corners = np.vstack([start, start + np.array([0, 0, 0.15])])
    fractions = np.linspace(0, 1, _NUM_POINTS)[:, None]
    path = np.vstack([a + fractions * (b - a) for a, b in pairwise(corners)])
    choices = [find_stances(scene, side, path) for side in range(4)]
    if not all(choices):
        return
    sets = np.array(list(product(*(range(len(c)) for c in choices))))
    feet = np.stack(
        [np.array([s.foot for s in c])[sets[:, i]] for i, c in enumerate(choices)], axis=1
    )
    cost = sum(np.array([s.cost for s in c])[sets[:, i]] for i, c in enumerate(choices))
    load = np.max([compute_max_load_fraction(feet, p) for p in corners], axis=0)
    foot_distance = np.min(
        [np.linalg.norm(feet[:, i] - feet[:, j], axis=-1) for i, j in combinations(range(4), 2)],
        axis=0,
    )
    limit = scene.module.max_force / scene.weight
    score = cost + 5 * np.maximum(load - 0.9 * limit, 0) / limit
    score = np.where(
        (foot_distance < _MIN_FOOT_DISTANCE) | ~has_enough_modules(scene, feet), np.inf, score
    )
    for k in np.argsort(score)[:max_sets]:
        if np.isfinite(score[k]):
            yield tuple(c[j] for c, j in zip(choices, sets[k], strict=True))


def has_enough_modules(scene: ModuleScene, feet: Array) -> BoolArray:
    """Return whether as many modules stand on each level as feet (n, 4, 3) need, bool (n,)."""
    heights = scene.start_position[scene.start_anchor < 0, 2]
    is_enough = np.ones(len(feet), bool)
    for height in np.unique(feet[..., 2]):
        num_on_level = int((np.abs(heights - height) < 1e-6).sum())
        is_enough &= (np.abs(feet[..., 2] - height) < 1e-6).sum(axis=1) <= num_on_level
    return is_enough


def compute_max_load_fraction(feet: Array, box: Array) -> Array:
    """Return the least possible largest fraction (n,) of the weight on one of four feet (n, 4, 3).

    Vertical forces that balance weight and moment have one degree of freedom. It minimises the
    largest force.
    """
    x, y = feet[..., 0] - box[0], feet[..., 1] - box[1]
    rows = np.stack([np.ones_like(x), x, y], axis=1)  # (n, 3, 4)
    particular = (np.linalg.pinv(rows) @ np.array([1.0, 0, 0])[:, None])[..., 0]
    nullspace = np.stack(
        [(-1) ** i * np.linalg.det(rows[:, :, [j for j in range(4) if j != i]]) for i in range(4)],
        axis=-1,
    )
    # The minimum is where two forces are equal or one vanishes
    candidates = [
        (particular[:, j] - particular[:, i], nullspace[:, i] - nullspace[:, j])
        for i, j in combinations(range(4), 2)
    ]
    candidates += [(-particular[:, i], nullspace[:, i]) for i in range(4)]
    min_max_force = np.full(len(feet), np.inf)
    for offset, slope in candidates:
        safe = np.where(np.abs(slope) > 1e-9, slope, np.inf)
        force = particular + (offset / safe)[:, None] * nullspace
        min_max_force = np.minimum(
            min_max_force, np.where(force.min(axis=1) < -1e-9, np.inf, force.max(axis=1))
        )
    return min_max_force
