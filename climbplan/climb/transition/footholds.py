"""What the search chooses from: footholds of every limb, body poses, and what reaches what."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.raw_surface import raw_body_room
from climbplan.climb.transition.clear_standing import ClearStanding, clear_standing
from climbplan.climb.transition.scene import TransitionScene, hull_room
from climbplan.robots.kinematics import inverse, to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Region, Surface

START, GOAL = 0, 1  # numbers of every limb's first two footholds; others lie between
_EDGE = 0.02  # [m] that footholds between start and goal keep from a surface's edges
_SAME = 1e-6  # [m]


@dataclass(frozen=True)
class Footholds:
    """C footholds of each of N limbs; a limb with fewer repeats its goal, which `real` tells."""

    toe: Array  # (N, C, 3) [m]
    region: IntArray  # (N, C)
    normal: Array  # (N, C, 3) unit, into free space
    mu: Array  # (N, C)
    real: BoolArray  # (N, C)

    @property
    def count(self) -> int:
        """C."""
        return self.toe.shape[1]


@dataclass(frozen=True)
class Poses:
    """B body poses; the first is the start's, the last the goal's."""

    com: Array  # (B, 3) [m]
    rpy: Array  # (B, 3) [rad]

    @property
    def count(self) -> int:
        """B."""
        return len(self.com)


@dataclass(frozen=True)
class Reach:
    """Which footholds limbs reach from which poses, and how."""

    valid: BoolArray  # (B, N, C) in reach, and no limb in the terrain or the body
    clear: ClearStanding
    angles: Array  # (B, N, C, J) [rad], NaN where not valid


def footholds_of(scene: TransitionScene) -> Footholds:
    """Start and goal of every limb and, as the spec has it, places between."""
    limbs = range(scene.robot.limb_count)
    places = [_between(scene, limb) for limb in limbs]
    count = 2 + max(len(p) for p in places)
    toe = np.repeat(scene.goal.toes[:, None], count, axis=1)
    region = np.repeat(scene.goal.region[:, None], count, axis=1)
    real = np.zeros((len(limbs), count), bool)
    toe[:, START], region[:, START] = scene.start.toes, scene.start.region
    real[:, GOAL] = True
    real[:, START] = np.linalg.norm(scene.start.toes - scene.goal.toes, axis=1) > _SAME
    for limb, found in enumerate(places):
        for number, (index, point) in enumerate(found, start=2):
            toe[limb, number], region[limb, number], real[limb, number] = point, index, True
    surfaces = scene.terrain.surfaces
    normal = np.empty_like(toe)
    for index, surface in enumerate(surfaces):
        normal[region == index] = surface.normal_at(toe[region == index])
    friction = np.array([s.friction for s in surfaces])
    return Footholds(toe, region, normal, friction[region], real)


def _between(scene: TransitionScene, limb: int) -> list[tuple[int, Array]]:
    """Surfaces and points between start and goal that a limb may use on its way."""
    wanted = scene.spec.search.between
    if wanted == "none":
        return []
    boxes = {box.name for box in scene.spec.terrain.boxes}
    ends = {int(scene.start.region[limb]), int(scene.goal.region[limb])}
    middle = (scene.start.toes[limb] + scene.goal.toes[limb]) / 2
    found: list[tuple[int, Array]] = []
    for index, surface in enumerate(scene.terrain.surfaces):
        if not scene.terrain.allowed[limb, index]:
            continue
        on_box = surface.name in boxes and index not in ends
        on_way = wanted == "any" and index == scene.goal.region[limb]
        if on_box or on_way:
            # On a box also where the limb gets to with the shortest step.
            for wish in (middle, scene.start.toes[limb]) if on_box else (middle,):
                point = _inside(surface, wish)
                known = [scene.goal.toes[limb], *(p for _, p in found)]
                if min(np.linalg.norm(point - other) for other in known) > _SAME:
                    found.append((index, point))
    return found


def _inside(surface: Surface, point: Array) -> Array:
    """The surface point nearest to a point, a little inside the edges where there is room."""
    near = surface.project(point)
    if not isinstance(surface, Region):
        return near
    for _ in range(2 * len(surface.b)):
        past = surface.A @ near - surface.b + _EDGE
        edge = int(np.argmax(past))
        if past[edge] <= 1e-12:
            return near
        near = near - past[edge] * surface.A[edge]
    return surface.project(point)


def poses_of(scene: TransitionScene, beside: Poses | None = None) -> Poses:
    """Poses on the straight way from start to goal and beside it, as far as the body has room.

    beside: further ones to look at.
    """
    start, goal, search = scene.start, scene.goal, scene.spec.search
    share = np.linspace(0.0, 1.0, search.heights)
    aside = [0.0] if search.aside == 0 else [0.0, -search.aside, search.aside]
    com, rpy = [start.com], [start.rpy]
    for part, dx, dy in itertools.product(share, aside, aside):
        pose = start.com + part * (goal.com - start.com) + [dx, dy, 0.0]
        turn = start.rpy + part * (goal.rpy - start.rpy)
        at_end = part in (0.0, 1.0) and dx == 0.0 and dy == 0.0
        if not at_end and _has_room(scene, pose, turn):
            com.append(pose)
            rpy.append(turn)
    for pose, turn in () if beside is None else zip(beside.com, beside.rpy, strict=True):
        if _has_room(scene, pose, turn):
            com.append(pose)
            rpy.append(turn)
    com.append(goal.com)
    rpy.append(goal.rpy)
    return Poses(np.array(com), np.array(rpy))


def _has_room(scene: TransitionScene, com: Array, rpy: Array) -> bool:
    hull = com + scene.robot.body_hull @ rotation_world_body(rpy).T
    asked = scene.spec.posture.body_clearance
    scan = scene.terrain.scan
    if scan is not None and raw_body_room(scan, hull, asked) < asked:
        return False
    return all(hull_room(hull, solid) >= asked for solid in scene.terrain.solids)


def reach_of(scene: TransitionScene, footholds: Footholds, poses: Poses) -> Reach:
    """Inverse kinematics of all footholds from all poses; toes hovering above must be in reach too.

    A limb lifts its toe along the normal before and after it swings.
    """
    robot = scene.robot
    hover = footholds.toe + scene.spec.trajectory.lift * footholds.normal
    angles, valid = [], []
    for number in range(footholds.count):
        found = []
        for points in (footholds.toe[:, number], hover[:, number]):
            all_poses = np.broadcast_to(points, (poses.count, *points.shape))
            found.append(inverse(robot, to_body(poses.com, poses.rpy, all_poses)))
        angles.append(found[0].best())
        valid.append(found[0].valid & found[1].valid & footholds.real[:, number])
    both = np.stack(valid, axis=2), np.stack(angles, axis=2)
    clear = clear_standing(scene, poses.com, poses.rpy, both[1])
    return Reach(both[0] & clear.alone, clear, both[1])
