"""Who goes where: modules drive up, latch to walls or to each other, and reach for the box."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import BRANCHES, in_range, inverse
from climbplan.limms.modules.limbs import root_on_anchor, side_pose, standing_rotation
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import drive, reach
from climbplan.limms.motion.straight_ways import LENGTH_ROWS, leave, straight_in
from climbplan.limms.motion.timeline import ARM, DRIVES, LEG, NOWHERE, PartialPlan
from climbplan.limms.scene.bounds import is_on_ground
from climbplan.limms.scene.limms_scene import Pose, Scene
from climbplan.limms.scene.phases import Limb

_RINGS = (0.25, 0.35, 0.45, 0.55, 0.65)
_SPOKES = 16
_SPARE = 0.02  # [rad] of rolls from their ranges, for what an arm does when it lets go


def initial(scene: Scene) -> PartialPlan:
    """Where everything is at the start: modules straight, upright or along anchors' normals."""
    count = scene.num_modules
    position, rotation = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
    for module in range(count):
        if scene.start_anchor[module] >= 0:
            pose = root_on_anchor(scene, int(scene.start_anchor[module]) - scene.wall_offset, 0)
            position[module], rotation[module] = pose
        else:
            position[module] = scene.start_position[module]
    return PartialPlan.of(scene, (position, rotation), np.zeros((count, 6)))


def root_pose(world: PartialPlan, module: int, end: int) -> Pose:
    """Where an end of a module is now."""
    points = world.points(module)
    return Pose(points.position[7 * end], points.rotation[7 * end])


def spots(scene: Scene, height: float, target: Pose, around: Array) -> Iterator[Array]:
    """Points of ground of one height round a place, near ones to `around` first."""
    found = []
    for ring in _RINGS:
        for angle in np.linspace(0, 2 * np.pi, _SPOKES, endpoint=False):
            flat = target.position[:2] + ring * np.array([np.cos(angle), np.sin(angle)])
            point = np.array([*flat, height])
            if any(
                abs(p.height - height) < 1e-6 and p.contains(point, 0.05) for p in scene.patches
            ):
                found.append(point)
    found.sort(key=lambda point: float(np.linalg.norm(point - around)))
    yield from found


def let_go(world: PartialPlan, module: int) -> PartialPlan:
    """As the world is, but a module that stands upright on an anchor of the ground drives."""
    scene, anchor = world.scene, int(world.base_anchor[module])
    if anchor < scene.wall_offset or not is_on_ground(scene, anchor - scene.wall_offset):
        return world
    freed = world.copy()
    freed.base_anchor[module] = NOWHERE
    freed.mode[module] = DRIVES
    freed.grounded[module] = 0
    return freed


def latch_from_ground(
    world: PartialPlan,
    module: int,
    target: Pose,
    anchor: int,
    mode: int,
    name: str,
    rng: np.random.Generator,
    tries: int = 4,
) -> PartialPlan:
    """Drive to a point from which the last end reaches `target`, latch it, and lift the first end.

    Raises:
        Blocked: no such point was found.
    """
    scene = world.scene
    world = let_go(world, module)
    here = world.base_position[module]
    failures = 0
    for point in spots(scene, float(here[2]), target, here):
        base = Pose(point, standing_rotation(0))
        moved = world.copy()
        moved.base_position[module] = point
        for branch in BRANCHES:
            solution = inverse(scene.module, base, target, branch)
            angles = solution.angles
            if solution.missing > 0 or in_range(scene.module, angles) > 0:
                continue
            if straight_in(moved, module, base, 0, target, angles, LENGTH_ROWS[-1]) is None:
                continue
            attempt = world.copy()
            try:
                drive(attempt, module, point, f"{name}: drive", rng)
                reach(attempt, module, base, 0, target, angles, f"{name}: reach", rng)
                attempt.mode[module] = mode
                attempt.tip_anchor[module] = anchor
                attempt.grounded[module] = NOWHERE
                leave(attempt, module, target, 1, f"{name}: lift off")
            except Blocked:
                failures += 1
                if failures >= tries:
                    raise
                break
            return attempt
    raise Blocked(
        f"{name}: no place to stand from which module {scene.module_names[module]} reaches"
    )


def latch_arm(
    world: PartialPlan, module: int, wall: int, name: str, rng: np.random.Generator
) -> tuple[PartialPlan, int]:
    """Latch a module to an anchor of the terrain; returns which of its ends is free."""
    anchor = world.scene.wall_offset + wall
    if world.base_anchor[module] == anchor:
        return world, 1
    if world.tip_anchor[module] == anchor:
        return world, 0
    target = root_on_anchor(world.scene, wall, 1)
    return latch_from_ground(world, module, target, anchor, ARM, name, rng), 0


def reach_box(
    world: PartialPlan, limb: Limb, box: Array, path: Array, name: str, rng: np.random.Generator
) -> None:
    """Bring an arm's free end to its anchor of the box at rest, touching but not latched.

    box: (D,) where it stands;
    path: (n, 6) joint angles of what it does with the box then, from where it latches [rad]. Of
    the whole turns that its rolls may stand at, those are taken with which all of it is in range.

    Raises:
        Blocked: no free way was found.
    """
    target = side_pose(world.scene, box, limb.side, limb.box_end)
    root = Pose(limb.fixed_position, limb.other_rotation)
    ending = _turned(path, world.angles[limb.module], np.array(world.scene.module.joint_range))
    reach(world, limb.module, root, 1 - limb.box_end, target, ending, name, rng)


def _turned(path: Array, now: Array, limits: Array) -> Array:
    """The beginning (6,) of a path (n, 6) by whole turns near to `now` with all of it in range."""
    whole = np.unwrap(path, axis=0)
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    begin = whole[0] + turns  # (5, 6)
    over = np.abs(whole[:, None] + turns).max(axis=0) - limits + _SPARE
    # Nearest among those in range; where none is, the one that is least beyond it
    rank = np.where(over <= 0, np.abs(begin - now), 1e3 * (1 + over))
    chosen: Array = np.take_along_axis(begin, rank.argmin(axis=0)[None], axis=0)[0]
    return chosen


def latch_box(world: PartialPlan, limbs: Sequence[Limb]) -> None:
    """Latch all limbs to the box, at once."""
    for limb in limbs:
        anchors = world.base_anchor if limb.box_end == 0 else world.tip_anchor
        anchors[limb.module] = limb.side
        if limb.is_leg:
            world.mode[limb.module] = LEG


def stand_leg(
    world: PartialPlan, limb: Limb, foot: Array, angles: Array, rng: np.random.Generator
) -> None:
    """Drive a module to its first foothold and bring its last end to the box, not latched yet.

    Raises:
        Blocked: no free way was found.
    """
    scene, module = world.scene, limb.module
    name = scene.module_names[module]
    drive(world, module, foot, f"{name}: drive", rng)
    root = Pose(foot, standing_rotation(0))
    target = side_pose(scene, world.place, limb.side, limb.box_end)
    limits = np.array(scene.module.joint_range)
    now = world.angles[module]
    wrap_angle = angles + np.round((now - angles) / (2 * np.pi)) * 2 * np.pi
    ending = np.where(np.abs(wrap_angle) <= limits, wrap_angle, angles)
    reach(world, module, root, 0, target, ending, f"{name}: reach", rng)
