"""Arms on arms: where a module that is latched to the wall holds the end that carries another one.

The first module of a chain (the carrier) is latched to the terrain and holds its free end still
while the second (the added arm, rules 9 to 11) moves the box: to the added arm that end is an
anchor like any other. Where it is best held is searched for: places between anchor and box from
which the added arm serves the whole way of the box in one branch, that the carrier reaches, and
where the added arm can come to from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import BRANCHES, in_range, inverse
from climbplan.limms.modules.limbs import side_pose, standing_rotation
from climbplan.limms.motion.moving import gaps, rooted
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.limms_scene import Pose, Scene

_OUT = (0.3, 0.45, 0.6, 0.75)  # [m] from the anchor, along its normal
_ASIDE = (-0.3, -0.15, 0.0, 0.15, 0.3)  # [m] across it
_RINGS = (0.25, 0.4, 0.55)  # [m] from a place to where a module may stand for it
_SPOKES = 8
_MARGIN = 0.01  # [m] of the carrier from everything


@dataclass(frozen=True)
class Grip:
    """A still end that carries: where the added arm's latched end is, and the carrier's joints."""

    root: Pose  # of the added arm's last end
    carrier: Array  # (6,) [rad]
    turning: float  # [rad] of the added arm's joints along the way of the box


def grips(
    world: PartialPlan,
    carrier: int,
    side: int,
    path: Array,
    ground: tuple[float, ...],
    most: int = 6,
) -> list[Grip]:
    """Places to hold an added arm at, those first from which it turns least along its way.

    world: the carrier latched to the terrain, all else where it is then; side: of the box that the
    added arm takes; path: (T, D) placements of the box; ground: heights where modules stand.
    """
    scene = world.scene
    wall_end = 1 if world.tip_anchor[carrier] >= 0 else 0
    points = world.points(carrier)
    anchored = Pose(points.position[7 * wall_end], points.rotation[7 * wall_end])
    normal = anchored.rotation[:, 2] * (1.0 if wall_end == 0 else -1.0)
    places, frames = _candidates(anchored.position, normal)
    turning = _turning(scene, side, places, frames, path)
    kept = np.isfinite(turning)
    kept[kept] = _served(scene, places[kept], frames[kept], ground)
    order = np.flatnonzero(kept)[np.argsort(turning[kept])]
    found: list[Grip] = []
    for k in order:
        target = Pose(places[k], frames[k])
        angles = _carried(world, carrier, wall_end, anchored, target)
        if angles is not None:
            found.append(Grip(target, angles, float(turning[k])))
        if len(found) >= most:
            break
    return found


def _candidates(anchor: Array, normal: Array) -> tuple[Array, Array]:
    """Places (N, 3) and frames (N, 3, 3) of the added arm's last end, its z axis to the anchor."""
    up = np.array([0.0, 0.0, 1.0])
    if abs(normal @ up) > 0.5:
        up = np.array([1.0, 0.0, 0.0])
    across = np.cross(normal, up)
    directions = [
        _unit(-normal + a * up + b * across) for a, b in product((-1.0, 0.0, 1.0), repeat=2)
    ] + [up, -up, across, -across]
    places, frames = [], []
    for out, a, b in product(_OUT, _ASIDE, _ASIDE):
        for z in directions:
            places.append(anchor + out * normal + a * up + b * across)
            frames.append(_frame(z))
    return np.array(places), np.array(frames)


def _unit(vector: Array) -> Array:
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _frame(z: Array) -> Array:
    """A rotation with this z axis; how it rolls about it does not matter, next to it are rolls."""
    x = _unit(np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0], z))
    return np.column_stack([x, np.cross(z, x), z])


def _turning(scene: Scene, side: int, places: Array, frames: Array, path: Array) -> Array:
    """How far joints of the added arm turn along the way (N) [rad]; infinite where it cannot."""
    on_box = side_pose(scene, path[:, None], side, 0)  # (T, 1, 3)
    count = (len(path), len(places), 3)
    first = Pose(
        np.broadcast_to(on_box.position, count), np.broadcast_to(on_box.rotation, (*count, 3))
    )
    last = Pose(np.broadcast_to(places, count), np.broadcast_to(frames, (*count, 3)))
    best = np.full(len(places), np.inf)
    for branch in BRANCHES:
        solution = inverse(scene.module, first, last, branch)
        angles = np.unwrap(solution.angles, axis=0)
        turn = np.round((angles.max(axis=0) + angles.min(axis=0)) / 2 / (2 * np.pi))
        angles = angles - turn * 2 * np.pi * (np.array(scene.module.joint_range) > np.pi)
        cannot = (solution.missing > 0).any(axis=0)
        cannot |= (in_range(scene.module, angles, 0.15) > 0).any(axis=0)
        length = np.abs(np.diff(angles, axis=0)).max(axis=-1).sum(axis=0)
        best = np.minimum(best, np.where(cannot, np.inf, length))
    return best


def _served(scene: Scene, places: Array, frames: Array, ground: tuple[float, ...]) -> BoolArray:
    """Which places (N) a module that stands on the ground reaches with its last end."""
    ok = np.zeros(len(places), bool)
    for height, ring in product(ground, _RINGS):
        for angle in np.linspace(0, 2 * np.pi, _SPOKES, endpoint=False):
            flat = places[:, :2] + ring * np.array([np.cos(angle), np.sin(angle)])
            stands = np.column_stack([flat, np.full(len(flat), height)])
            there = np.zeros(len(places), bool)
            for patch in scene.patches:
                if abs(patch.height - height) < 1e-6:
                    there |= patch.contains(stands, 0.05)
            base = Pose(stands, np.broadcast_to(standing_rotation(0), (len(stands), 3, 3)))
            for branch in BRANCHES if there.any() else ():
                solution = inverse(scene.module, base, Pose(places, frames), branch)
                fits = (solution.missing <= 0) & (in_range(scene.module, solution.angles) <= 0)
                ok |= there & fits
    return ok


def _carried(
    world: PartialPlan, carrier: int, wall_end: int, anchored: Pose, target: Pose
) -> Array | None:
    """Joints of the carrier (6,) that hold its free end in line with the added arm; or None."""
    scene = world.scene
    if wall_end == 1:
        first, last = target, anchored
    else:
        first, last = anchored, Pose(target.position, target.rotation @ np.diag([1.0, -1, -1]))
    options: list[tuple[float, Array]] = []
    for branch in BRANCHES:
        solution = inverse(scene.module, first, last, branch)
        angles = solution.angles
        if solution.missing > 0 or in_range(scene.module, angles, 0.05) > 0:
            continue
        clear = float(
            gaps(world, carrier, rooted(world, anchored, wall_end, angles[None]), wall_end)[0]
        )
        if clear >= _MARGIN:
            options.append((float(np.abs(angles - world.angles[carrier]).max()), angles))
    return min(options, key=lambda option: option[0])[1] if options else None


def grounds(scene: Scene) -> tuple[float, ...]:
    """Heights of the ground that modules stand on at the start [m]."""
    return tuple(
        sorted({float(stand[2]) for stand in scene.start_position if not np.isnan(stand).any()})
    )


def pairs(choices: list[list[Grip]], most: int = 6) -> Iterator[tuple[Grip, ...]]:
    """A grip for each chain, those first that turn least together."""
    every = sorted(product(*choices), key=lambda each: sum(grip.turning for grip in each))
    yield from every[:most]
