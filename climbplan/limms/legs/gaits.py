"""Contact sequences of a quadruped, simplest first, and where feet may stand on the way.

Candidates: standing on four feet, a leap (all feet in the air), and crawls of growing numbers of
steps in every order of legs. None of them is written for a scene: patches, blocks and footholds
follow from the way that the box takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, Scene
from climbplan.limms.scene.phases import Limb

STANCE = 0.45  # [m] of a foot from the face of the box, nominal
HEIGHT = 0.36  # [m] of the box's centre above the ground under it while it moves, nominal
GROUND_MARGIN = 0.06  # [m] of nominal footholds from edges
STRIDE = 0.36  # [m] of a cycle of steps at most


@dataclass(frozen=True)
class Gait:
    """Which limbs are in the air in each phase; an empty tuple is a stance."""

    name: str
    swings: tuple[tuple[int, ...], ...]

    @property
    def steps(self) -> int:
        """Phases with feet in the air."""
        return sum(bool(s) for s in self.swings)


def gaits(limbs: int, blocks: int, shift: Array, reach: float, most_steps: int) -> Iterator[Gait]:
    """Contact sequences, those with the fewest phases first.

    shift: from start to goal (3,) [m]; reach: from an anchor of the box to a foot at most [m]. Feet
    stay ahead of their faces, so that standing feet let the box go no further than their reach;
    crawls too short by far are left out as well.
    """
    length = float(np.linalg.norm(shift))
    if np.abs(shift[:2]).max() <= reach:
        yield Gait("stand", ((),) * blocks)
    everything = tuple(range(limbs))
    if most_steps >= 1:
        # Time runs differently in crouching and pushing off, in landing and coming to rest
        yield Gait("leap", ((), (), everything, (), ()))
    for cycles in range(1, most_steps // limbs + 1):
        if length > STRIDE * cycles:
            continue
        for order in crawl_orders(limbs):
            steps = tuple((leg,) for leg in order * cycles)
            yield Gait("crawl " + "-".join(str(i) for i in order * cycles), ((), *steps, ()))


def crawl_orders(limbs: int) -> list[tuple[int, ...]]:
    """Orders in which legs step, neighbours in turn before opposite ones (2 k and 2 k + 1)."""

    def opposites(order: tuple[int, ...]) -> int:
        return sum(a // 2 == b // 2 for a, b in pairwise((*order, order[0])))

    # The same cycle begun elsewhere is not tried again
    every = [order for order in permutations(range(limbs)) if order[0] == 0]
    return sorted(every, key=opposites)


def patch_under(scene: Scene, point: Array, below: float) -> int:
    """The highest patch not above `below` that holds a point, else the nearest one."""
    best, key = -1, (np.inf, np.inf)
    for k, patch in enumerate(scene.patches):
        if patch.height > below + 1e-9 or (patch.upper - patch.lower < 2.2 * GROUND_MARGIN).any():
            continue
        near = np.clip(point[:2], patch.lower + GROUND_MARGIN, patch.upper - GROUND_MARGIN)
        away = float(np.linalg.norm(near - point[:2]))
        score = (round(away, 3), -patch.height)
        if score < key:
            best, key = k, score
    return best


def foothold(scene: Scene, patch: int, point: Array) -> Array:
    """The point of a patch nearest to a nominal foothold (3,) [m]."""
    ground = scene.patches[patch]
    flat = np.clip(point[:2], ground.lower + GROUND_MARGIN, ground.upper - GROUND_MARGIN)
    return np.array([*flat, ground.height])


def nominal_feet(
    scene: Scene, limbs: Sequence[Limb], box: Array, below: float
) -> tuple[Array, list[int]]:
    """Footholds (limbs, 3) round a box centre, and their patches."""
    points, patches = [], []
    for limb in limbs:
        normal = SIDE_NORMALS[limb.side]
        away = abs(normal) @ scene.box_size[0] / 2 + STANCE
        point = box + away * normal
        patch = patch_under(scene, point, below)
        patches.append(patch)
        points.append(foothold(scene, patch, point))
    return np.array(points), patches


def centre_path(scene: Scene, gait: Gait, way: Corridor, start: Array, goal: Array) -> Array:
    """Box centres (phases + 1, 3) between phases."""
    phases = len(gait.swings)
    if gait.steps == 0:
        return np.vstack([start, way.crossings, goal])
    if gait.name == "leap":
        low, high = way.blocks[0]
        push = start.copy()
        push[2] = np.clip(start[2] + 0.25, low[2], high[2])
        push[:2] = np.clip(start[:2] + 0.35 * (goal - start)[:2], low[:2], high[:2])
        land = goal + np.array([0, 0, 0.05])
        return np.array([start, start + 0.6 * (push - start), push, land, goal, goal])
    raised, lowered = start.copy(), goal.copy()
    ground = start[2] - scene.box_size[0, 2] / 2
    raised[2] = max(start[2], ground + HEIGHT)
    share = np.linspace(0, 1, phases - 1)[:, None]
    middle = raised + share * (lowered - raised)
    return np.vstack([start, middle, goal]) if phases > 2 else np.array([start, raised, goal])
