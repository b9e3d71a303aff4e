"""Contact sequences of a quadruped, simplest first, and nominal footholds along the path.

Candidates are standing on four feet, a leap (all feet in the air), and crawls with growing numbers
of steps in every order of legs. They do not depend on a scene: patches, blocks and footholds follow
from the path of the box.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, ModuleScene
from climbplan.limms.scene.phases import SupportModule

STANCE = 0.45  # [m], nominal distance of a foot from the face of the box
HEIGHT = 0.36  # [m], nominal height of the centre above ground in motion
GROUND_MARGIN = 0.06  # [m] of nominal footholds from edges
STRIDE = 0.36  # [m], longest gait cycle


@dataclass(frozen=True)
class SwingPattern:
    """A contact sequence: limbs in the air in each phase; an empty tuple is a stance."""

    name: str
    swings: tuple[tuple[int, ...], ...]

    @property
    def steps(self) -> int:
        """The number of phases with feet in the air."""
        return sum(bool(s) for s in self.swings)


def generate_gaits(
    num_limbs: int, num_blocks: int, displacement: Array, reach: float, most_steps: int
) -> Iterator[SwingPattern]:
    """Yield contact sequences, those with the fewest phases first.

    Feet stay in front of their faces, so standing feet limit the box to their reach. Crawls that
    are much too short are left out.

    Args:
        num_limbs: Number of legs.
        num_blocks: Number of blocks of the corridor.
        displacement: From start to goal (3,) [m].
        reach: Largest distance from an anchor of the box to a foot [m].
        most_steps: Largest number of steps.
    """
    length = float(np.linalg.norm(displacement))
    if np.abs(displacement[:2]).max() <= reach:
        yield SwingPattern("stand", ((),) * num_blocks)
    all_limbs = tuple(range(num_limbs))
    if most_steps >= 1:
        # Crouching, pushing off, landing and coming to rest have durations of their own
        yield SwingPattern("leap", ((), (), all_limbs, (), ()))
    for cycles in range(1, most_steps // num_limbs + 1):
        if length > STRIDE * cycles:
            continue
        for order in list_crawl_orders(num_limbs):
            steps = tuple((leg,) for leg in order * cycles)
            yield SwingPattern(
                "crawl " + "-".join(str(i) for i in order * cycles), ((), *steps, ())
            )


def list_crawl_orders(num_limbs: int) -> list[tuple[int, ...]]:
    """Return orders in which legs step, neighbours before opposite ones (2 k and 2 k + 1)."""

    def count_opposites(order: tuple[int, ...]) -> int:
        return sum(a // 2 == b // 2 for a, b in pairwise((*order, order[0])))

    # Cyclic permutations of an order count once
    orders = [order for order in permutations(range(num_limbs)) if order[0] == 0]
    return sorted(orders, key=count_opposites)


def find_patch(scene: ModuleScene, point: Array, max_height: float) -> int:
    """Return the highest patch not above `max_height` that holds a point, else the nearest one."""
    best, key = -1, (np.inf, np.inf)
    for k, patch in enumerate(scene.patches):
        if (
            patch.height > max_height + 1e-9
            or (patch.upper - patch.lower < 2.2 * GROUND_MARGIN).any()
        ):
            continue
        nearest = np.clip(point[:2], patch.lower + GROUND_MARGIN, patch.upper - GROUND_MARGIN)
        distance = float(np.linalg.norm(nearest - point[:2]))
        score = (round(distance, 3), -patch.height)
        if score < key:
            best, key = k, score
    return best


def clip_to_patch(scene: ModuleScene, patch: int, point: Array) -> Array:
    """Return the point of a patch nearest to a nominal foothold (3,) [m]."""
    ground = scene.patches[patch]
    position = np.clip(point[:2], ground.lower + GROUND_MARGIN, ground.upper - GROUND_MARGIN)
    return np.array([*position, ground.height])


def compute_nominal_feet(
    scene: ModuleScene, limbs: Sequence[SupportModule], box: Array, below: float
) -> tuple[Array, list[int]]:
    """Return footholds (limbs, 3) around a box centre, and their patches."""
    points, patches = [], []
    for limb in limbs:
        normal = SIDE_NORMALS[limb.side]
        distance = abs(normal) @ scene.box_size[0] / 2 + STANCE
        point = box + distance * normal
        patch = find_patch(scene, point, below)
        patches.append(patch)
        points.append(clip_to_patch(scene, patch, point))
    return np.array(points), patches


def compute_centre_path(
    scene: ModuleScene, gait: SwingPattern, corridor: Corridor, start: Array, goal: Array
) -> Array:
    """Return the box centres (phases + 1, 3) between phases."""
    phases = len(gait.swings)
    if gait.steps == 0:
        return np.vstack([start, corridor.crossings, goal])
    if gait.name == "leap":
        low, high = corridor.blocks[0]
        takeoff = start.copy()
        takeoff[2] = np.clip(start[2] + 0.25, low[2], high[2])
        takeoff[:2] = np.clip(start[:2] + 0.35 * (goal - start)[:2], low[:2], high[:2])
        landing = goal + np.array([0, 0, 0.05])
        return np.array([start, start + 0.6 * (takeoff - start), takeoff, landing, goal, goal])
    raised, lowered = start.copy(), goal.copy()
    ground = start[2] - scene.box_size[0, 2] / 2
    raised[2] = max(start[2], ground + HEIGHT)
    fractions = np.linspace(0, 1, phases - 1)[:, None]
    middle = raised + fractions * (lowered - raised)
    return np.vstack([start, middle, goal]) if phases > 2 else np.array([start, raised, goal])
