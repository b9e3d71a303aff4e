"""The discrete choices of the search: footholds of every limb, body poses, and reachability."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.raw_surface import compute_raw_body_distance
from climbplan.climb.transition.scene import TransitionScene, compute_hull_distance
from climbplan.climb.transition.standing_clearance import (
    StandingClearance,
    compute_standing_clearance,
)
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Region, Surface

START, GOAL = 0, 1  # indices of every limb's first two footholds; others lie between
_EDGE_MARGIN = 0.02  # [m] that footholds between start and goal keep from a surface's edges
_SAME_TOLERANCE = 1e-6  # [m]


@dataclass(frozen=True)
class CandidateFootholds:
    """C footholds of each of N limbs; a limb with fewer repeats its goal, marked by `real`."""

    toe: Array  # (N, C, 3) [m]
    region: IntArray  # (N, C)
    normal: Array  # (N, C, 3) unit, into free space
    mu: Array  # (N, C)
    real: BoolArray  # (N, C)

    @property
    def count(self) -> int:
        """Number C of footholds of a limb."""
        return self.toe.shape[1]


@dataclass(frozen=True)
class CandidateBodyPoses:
    """B body poses; the first is the start's, the last the goal's."""

    com: Array  # (B, 3) [m]
    rpy: Array  # (B, 3) [rad]

    @property
    def count(self) -> int:
        """Number B of poses."""
        return len(self.com)


@dataclass(frozen=True)
class Reach:
    """Reachability of footholds from poses, with joint angles."""

    valid: BoolArray  # (B, N, C) in reach, and no limb in the terrain or the body
    clear: StandingClearance
    angles: Array  # (B, N, C, J) [rad], NaN where not valid


def list_footholds(scene: TransitionScene) -> CandidateFootholds:
    """List start and goal of every limb and, if the spec requests them, intermediate footholds."""
    limbs = range(scene.robot.limb_count)
    intermediate = [_find_intermediate_footholds(scene, limb) for limb in limbs]
    count = 2 + max(len(p) for p in intermediate)
    toe = np.repeat(scene.goal.toes[:, None], count, axis=1)
    region = np.repeat(scene.goal.region[:, None], count, axis=1)
    real = np.zeros((len(limbs), count), bool)
    toe[:, START], region[:, START] = scene.start.toes, scene.start.region
    real[:, GOAL] = True
    real[:, START] = np.linalg.norm(scene.start.toes - scene.goal.toes, axis=1) > _SAME_TOLERANCE
    for limb, options in enumerate(intermediate):
        for number, (index, point) in enumerate(options, start=2):
            toe[limb, number], region[limb, number], real[limb, number] = point, index, True
    surfaces = scene.terrain.surfaces
    normal = np.empty_like(toe)
    for index, surface in enumerate(surfaces):
        normal[region == index] = surface.normal_at(toe[region == index])
    friction = np.array([s.friction for s in surfaces])
    return CandidateFootholds(toe, region, normal, friction[region], real)


def _find_intermediate_footholds(scene: TransitionScene, limb: int) -> list[tuple[int, Array]]:
    """Find surfaces and points between start and goal that a limb may use on its way."""
    mode = scene.spec.search.between
    if mode == "none":
        return []
    boxes = {box.name for box in scene.spec.terrain.boxes}
    ends = {int(scene.start.region[limb]), int(scene.goal.region[limb])}
    midpoint = (scene.start.toes[limb] + scene.goal.toes[limb]) / 2
    options: list[tuple[int, Array]] = []
    for index, surface in enumerate(scene.terrain.surfaces):
        if not scene.terrain.allowed[limb, index]:
            continue
        on_box = surface.name in boxes and index not in ends
        on_way = mode == "any" and index == scene.goal.region[limb]
        if on_box or on_way:
            # On a box also the point that the limb reaches with the shortest step
            for target in (midpoint, scene.start.toes[limb]) if on_box else (midpoint,):
                point = _project_inside(surface, target)
                existing = [scene.goal.toes[limb], *(p for _, p in options)]
                if min(np.linalg.norm(point - toe) for toe in existing) > _SAME_TOLERANCE:
                    options.append((index, point))
    return options


def _project_inside(surface: Surface, point: Array) -> Array:
    """Project a point to a surface, with a margin from its edges if possible."""
    projected = surface.project(point)
    if not isinstance(surface, Region):
        return projected
    for _ in range(2 * len(surface.b)):
        excess = surface.A @ projected - surface.b + _EDGE_MARGIN
        edge = int(np.argmax(excess))
        if excess[edge] <= 1e-12:
            return projected
        projected = projected - excess[edge] * surface.A[edge]
    return surface.project(point)


def list_poses(
    scene: TransitionScene, extra_poses: CandidateBodyPoses | None = None
) -> CandidateBodyPoses:
    """List poses on the straight path from start to goal and lateral to it, with a clear body.

    extra_poses: further poses to include.
    """
    start, goal, search = scene.start, scene.goal, scene.spec.search
    fractions = np.linspace(0.0, 1.0, search.heights)
    offsets = (
        [0.0]
        if search.lateral_offset == 0
        else [0.0, -search.lateral_offset, search.lateral_offset]
    )
    com, rpy = [start.com], [start.rpy]
    for fraction, dx, dy in itertools.product(fractions, offsets, offsets):
        position = start.com + fraction * (goal.com - start.com) + [dx, dy, 0.0]
        rpy_at = start.rpy + fraction * (goal.rpy - start.rpy)
        at_end = fraction in (0.0, 1.0) and dx == 0.0 and dy == 0.0
        if not at_end and _is_body_clear(scene, position, rpy_at):
            com.append(position)
            rpy.append(rpy_at)
    for position, rpy_at in (
        () if extra_poses is None else zip(extra_poses.com, extra_poses.rpy, strict=True)
    ):
        if _is_body_clear(scene, position, rpy_at):
            com.append(position)
            rpy.append(rpy_at)
    com.append(goal.com)
    rpy.append(goal.rpy)
    return CandidateBodyPoses(np.array(com), np.array(rpy))


def _is_body_clear(scene: TransitionScene, com: Array, rpy: Array) -> bool:
    hull = com + scene.robot.body_hull @ rotation_world_body(rpy).T
    min_clearance = scene.spec.posture.body_clearance
    scan = scene.terrain.scan
    if scan is not None and compute_raw_body_distance(scan, hull, min_clearance) < min_clearance:
        return False
    return all(
        compute_hull_distance(hull, solid) >= min_clearance for solid in scene.terrain.solids
    )


def compute_reach(
    scene: TransitionScene, footholds: CandidateFootholds, poses: CandidateBodyPoses
) -> Reach:
    """Compute the inverse kinematics of all footholds from all poses.

    Toes lifted along the normal have to be in reach, too, as limbs lift before they swing.
    """
    robot = scene.robot
    hover = footholds.toe + scene.spec.trajectory.swing_clearance * footholds.normal
    angles, valid = [], []
    for number in range(footholds.count):
        solutions = []
        for points in (footholds.toe[:, number], hover[:, number]):
            all_poses = np.broadcast_to(points, (poses.count, *points.shape))
            solutions.append(
                solve_inverse_kinematics(robot, to_body(poses.com, poses.rpy, all_poses))
            )
        angles.append(solutions[0].best())
        valid.append(solutions[0].valid & solutions[1].valid & footholds.real[:, number])
    combined = np.stack(valid, axis=2), np.stack(angles, axis=2)
    clear = compute_standing_clearance(scene, poses.com, poses.rpy, combined[1])
    return Reach(combined[0] & clear.terrain_clear, clear, combined[1])
