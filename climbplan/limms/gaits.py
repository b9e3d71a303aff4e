"""Contact sequences of a quadruped, simplest first, and slow guesses of their motions.

Candidates: standing on four feet, a leap (all feet in the air), and crawls of growing numbers of
steps in every order of legs. None of them is written for a scene: patches, blocks and footholds
follow from the way that the box takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from climbplan.limms.chain import in_range
from climbplan.limms.corridor import Way
from climbplan.limms.limbs import limb_angles
from climbplan.limms.scene import GRAVITY, SIDE_NORMALS, Array, Scene
from climbplan.limms.statement import Limb, Phase, Trace

STANCE = 0.45  # [m] of a foot from the face of the box, nominal
HEIGHT = 0.36  # [m] of the box's centre above the ground under it while it moves, nominal
MARGIN = 0.06  # [m] of nominal footholds from edges
SPEED = 0.3  # [m/s] of guesses


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
        if length > 0.75 * cycles:
            continue
        for order in permutations(everything):
            if order[0] != 0 and cycles > 1:
                continue  # the same cycle, begun elsewhere
            swings: list[tuple[int, ...]] = [()]
            for _ in range(cycles):
                for leg in order:
                    swings += [(leg,), ()]
            yield Gait("crawl " + "-".join(str(i) for i in order * cycles), tuple(swings))


def patch_under(scene: Scene, point: Array, below: float) -> int:
    """The highest patch not above `below` that holds a point, else the nearest one."""
    best, key = -1, (np.inf, np.inf)
    for k, patch in enumerate(scene.patches):
        if patch.height > below + 1e-9 or (patch.upper - patch.lower < 2.2 * MARGIN).any():
            continue
        near = np.clip(point[:2], patch.lower + MARGIN, patch.upper - MARGIN)
        away = float(np.linalg.norm(near - point[:2]))
        score = (round(away, 3), -patch.height)
        if score < key:
            best, key = k, score
    return best


def foothold(scene: Scene, patch: int, point: Array) -> Array:
    """The point of a patch nearest to a nominal foothold (3,) [m]."""
    ground = scene.patches[patch]
    flat = np.clip(point[:2], ground.lower + MARGIN, ground.upper - MARGIN)
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


def guess_for(
    scene: Scene,
    limbs: Sequence[Limb],
    gait: Gait,
    way: Way,
    start: Array,
    goal: Array,
    first_feet: Array,
    first_patches: Sequence[int],
) -> list[Trace]:
    """A slow motion of a contact sequence along a way, feet moved to nominal places on the way."""
    corners = _centre_path(scene, gait, way, start, goal)
    traces: list[Trace] = []
    feet, patches = first_feet.copy(), list(first_patches)
    previous: Array | None = None
    n = len(limbs)
    for number, swing in enumerate(gait.swings):
        first, last = corners[number], corners[number + 1]
        leap = len(swing) == n
        below = last[2]
        target, target_patches = feet.copy(), list(patches)
        if swing:
            ahead = corners[-1] if leap else corners[min(number + 2 * n, len(corners) - 1)]
            aim = last if leap else last + 0.5 * (ahead - last)
            wanted, ground = nominal_feet(scene, limbs, aim, below)
            for i in swing:
                target[i], target_patches[i] = wanted[i], ground[i]
        count = (12 if leap else 4) if swing else (7 if gait.steps <= 1 else 3)
        share = np.linspace(0, 1, count + 1)[:, None]
        length = float(np.linalg.norm(last - first))
        duration = 0.35 if leap else max(length / SPEED, 0.35 if not swing else 0.6)
        position = first + share * (last - first)
        path = feet[None] + share[:, :, None] * (target - feet)[None]
        arch = 4 * share[:, 0] * (1 - share[:, 0]) * 0.12
        for i in swing:
            path[:, i, 2] += arch
        angles = np.zeros((count + 1, n, 6))
        for i, limb in enumerate(limbs):
            angles[:, i] = limb_angles(scene, limb, position, path[:, i], limb.branch)[0]
        if previous is not None:
            angles += np.round((previous - angles[0]) / (2 * np.pi)) * 2 * np.pi
        previous = angles[-1]
        block = _block_for(way, first, last)
        standing = n - len(swing)
        load = np.zeros((count + 1, n, 3))
        for i in range(n):
            if i not in swing:
                load[:, i, 2] = scene.weight / standing
        acceleration = np.zeros((count + 1, 3))
        if leap:
            acceleration[:, 2] = -GRAVITY
        limits = (0.1, 1.0) if leap else (0.15, 6.0) if swing else (0.05, 8.0)
        phase = Phase(
            "quadruped",
            block[0],
            block[1],
            count,
            *limits,
            swing=swing,
            patches=dict(enumerate(target_patches)),
        )
        velocity = np.broadcast_to((last - first) / duration, position.shape)
        traces.append(Trace(phase, duration, position, velocity, acceleration, angles, path, load))
        feet, patches = target, target_patches
    return traces


def _centre_path(scene: Scene, gait: Gait, way: Way, start: Array, goal: Array) -> Array:
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


def _block_for(way: Way, first: Array, last: Array) -> Array:
    """The block that holds both ends of a phase best."""

    def outside(block: Array) -> float:
        return float(
            sum(np.maximum(np.maximum(block[0] - p, p - block[1]), 0).sum() for p in (first, last))
        )

    best: Array = min(way.blocks, key=outside)
    return best


def reachable(scene: Scene, limb: Limb, box: Array, foot: Array) -> float:
    """By how much a foothold is out of a leg's reach or range; <= 0 if it can be stood on."""
    angles, missing = limb_angles(scene, limb, box[None], foot[None], limb.branch)
    if missing[0] > 0:
        return float(missing[0])
    return float(in_range(scene.module, angles)[0])
