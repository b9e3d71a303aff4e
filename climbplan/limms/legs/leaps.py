"""Feasible leaps of all four legs: take-off and landing, found before any program is solved.

Poses of a leg on a grid of box centres over its foothold are listed once with their Jacobians.
Leaps are then sampled at random. Each leg looks for a pair of poses that has the speed at both
ends, turns from one to the other during the flight, and reaches start and goal.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.legs.gaits import find_patch
from climbplan.limms.modules.chain import BRANCHES, range_excess
from climbplan.limms.modules.limbs import build_leg, compute_limb_angles, compute_limb_points
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, ModuleScene
from climbplan.limms.scene.phases import SupportModule

HEIGHTS = np.arange(0.2, 0.72, 0.06)  # [m] of the centre of the box above ground at both ends
GRID = np.arange(-0.78, 0.79, 0.06)  # [m] of the centre of the box from a foothold
TAKEOFF_OFFSETS = np.arange(-0.2, 0.75, 0.05)  # [m] of take-off from the start, towards the goal
MAX_SAMPLES = 800
MAX_LEAPS = 4
SPEED_FRACTION = 0.9  # of joint speeds
TURN_FRACTION = 0.85  # of joint speeds times duration of the flight
EDGE_MARGIN = 0.04  # [m] of feet from edges
FACE_CLEARANCE = 0.025  # [m]
RANGE_MARGIN = 0.1  # [rad] of joint ranges
APPROACH_MARGIN = 0.2  # [rad] of joint ranges where latches close
MIN_ELBOW = 0.12  # [rad]
_STEP = 1e-5

_PosePair = tuple[float, int, int, int]  # slack, branch, poses at take-off and landing


@dataclass(frozen=True)
class Leap:
    """A leap: the box at take-off and landing, footholds before and after, branches."""

    takeoff: Array  # (3,) [m]
    landing: Array  # (3,)
    speed: Array  # (3,) at take-off [m/s]
    duration: float  # [s]
    before: Array  # (4, 3) [m]
    after: Array  # (4, 3)
    patches: tuple[int, int]
    branches: tuple[tuple[int, int, int], ...]
    angles: Array  # (4, 2, 6) at take-off and landing, without full turns between [rad]
    slack: float  # fraction of joint speeds that is left


@dataclass(frozen=True)
class _LegPoses:
    """Poses of one leg in one branch."""

    over: Array  # (n, 3) centre - foothold [m]
    angles: Array  # (n, 6) [rad]
    jacobian: Array  # (n, 6, 3) [rad/m]
    level: IntArray  # (n,) index of the height


def find_leaps(
    scene: ModuleScene, goal: Array, rng: np.random.Generator, deadline: float = np.inf
) -> list[Leap]:
    """Find leaps from the start of the box towards its goal, those with most slack first.

    Args:
        scene: The scene.
        goal: Goal of the box (3,) [m].
        rng: Random generator.
        deadline: Time after which no more are sampled, as `time.monotonic` [s].
    """
    start = scene.box_start[0]
    first = find_patch(scene, start, start[2])
    last = find_patch(scene, goal, goal[2])
    drop = scene.patches[first].height - scene.patches[last].height
    displacement = goal[:2] - start[:2]
    distance = float(np.linalg.norm(displacement))
    direction = (
        np.array([*(displacement / distance), 0.0])
        if distance > 1e-6
        else np.array([1.0, 0.0, 0.0])
    )
    poses = [[_list_poses(scene, side, branch) for branch in BRANCHES] for side in range(4)]
    leaps: list[Leap] = []
    max_speed = 0.45 * scene.module.max_joint_speed
    for _ in range(MAX_SAMPLES):
        if time.monotonic() > deadline:
            break
        vertical_speed, forward_speed = (
            rng.uniform(-0.2, 0.6) * max_speed,
            rng.uniform(0.4, 1.0) * max_speed,
        )
        first_level, last_level = rng.integers(len(HEIGHTS), size=2)
        square = vertical_speed**2 + 2 * GRAVITY * (
            HEIGHTS[first_level] + drop - HEIGHTS[last_level]
        )
        if square <= 0:
            continue
        duration = float((vertical_speed + np.sqrt(square)) / GRAVITY)
        if forward_speed * duration < 0.35:
            continue
        leap = _build_leap(
            scene,
            poses,
            speed=direction * forward_speed + [0, 0, vertical_speed],
            duration=duration,
            levels=(int(first_level), int(last_level)),
            patches=(first, last),
            ends=(start, goal),
            direction=direction,
        )
        if leap is not None:
            leaps.append(leap)
            if len(leaps) >= MAX_LEAPS:
                break
    leaps.sort(key=lambda leap: -leap.slack)
    return leaps


def _list_poses(scene: ModuleScene, side: int, branch: tuple[int, int, int]) -> _LegPoses:
    """Return the feasible poses of a leg in a branch, with Jacobians by finite differences."""
    limb = build_leg(0, side, 1, branch)
    x, y, z = (m.ravel() for m in np.meshgrid(GRID, GRID, HEIGHTS, indexing="ij"))
    offsets = np.column_stack([x, y, z])
    half_edge = float(abs(SIDE_NORMALS[side]) @ scene.box_size[0] / 2)
    offsets = offsets[-offsets @ SIDE_NORMALS[side] >= half_edge + FACE_CLEARANCE]
    angles, is_feasible = compute_poses(scene, limb, offsets, RANGE_MARGIN)
    offsets, angles = offsets[is_feasible], angles[is_feasible]
    jacobian = np.zeros((len(offsets), 6, 3))
    for axis in range(3):
        shifted, _ = compute_poses(scene, limb, offsets + _STEP * np.eye(3)[axis], RANGE_MARGIN)
        jacobian[..., axis] = _wrap(shifted - angles) / _STEP
    level = np.rint((offsets[:, 2] - HEIGHTS[0]) / (HEIGHTS[1] - HEIGHTS[0])).astype(int)
    return _LegPoses(offsets, angles, jacobian, level)


def compute_poses(
    scene: ModuleScene, limb: SupportModule, offsets: Array, margin: float
) -> tuple[Array, BoolArray]:
    """Return angles (n, 6) of a leg and whether they are feasible, bool (n,).

    Feasible poses are in reach and in range, with links off ground and box as far as points of the
    links tell.

    Args:
        scene: The scene.
        limb: The leg.
        offsets: Centre of the box from the foot (n, 3) [m].
        margin: Margin of the joint ranges [rad].
    """
    feet = np.zeros_like(offsets)
    angles = np.zeros((len(offsets), 6))
    if not len(offsets):
        return angles, np.zeros(0, bool)
    angles, reach_error = compute_limb_angles(scene, limb, offsets, feet, limb.branch)
    angles = _wrap(angles)
    is_feasible = (reach_error <= 0) & (range_excess(scene.module, angles, margin) <= 0)
    is_feasible &= np.abs(angles[:, 2]) > MIN_ELBOW
    points = compute_limb_points(scene, limb, offsets, feet, angles).position
    radius = scene.module.radius
    is_feasible &= (points[:, 2:7, 2] >= radius).all(axis=1)
    half = scene.box_size[0] / 2 + radius
    for fraction in (0.0, 0.3, 0.6):  # points from elbow to wrist
        point = points[:, 3] + fraction * (points[:, 5] - points[:, 3])
        is_feasible &= ~(np.abs(point - offsets) < half).all(axis=1)
    return angles, is_feasible


def _wrap(angles: Array) -> Array:
    """Return angles wrapped to [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _build_leap(
    scene: ModuleScene,
    poses: Sequence[Sequence[_LegPoses]],
    *,
    speed: Array,
    duration: float,
    levels: tuple[int, int],
    patches: tuple[int, int],
    ends: tuple[Array, Array],
    direction: Array,
) -> Leap | None:
    """Return the leap with a sampled speed and heights, or None unless every leg can do it."""
    ground = [scene.patches[k].height for k in patches]
    landing_speed = speed - np.array([0, 0, GRAVITY * duration])
    takeoffs = ends[0] + TAKEOFF_OFFSETS[:, None] * direction
    takeoffs[:, 2] = ground[0] + HEIGHTS[levels[0]]
    landings = takeoffs + speed * duration
    landings[:, 2] = ground[1] + HEIGHTS[levels[1]]
    choices: list[list[_PosePair | None]] = []
    for side in (1, 0, 2, 3):
        matches = _match_poses(
            scene,
            side,
            poses[side],
            speeds=(speed, landing_speed),
            duration=duration,
            levels=levels,
            patches=patches,
            centres=(takeoffs, landings),
            ends=ends,
        )
        if all(choice is None for choice in matches):
            return None
        choices.append(matches)
    choices = [choices[1], choices[0], choices[2], choices[3]]
    best, slack = _select_takeoff(choices)
    if best < 0:
        return None
    before, after, angles, branches = [], [], [], []
    for side, matches in enumerate(choices):
        choice = matches[best]
        assert choice is not None
        _, branch, i, j = choice
        leg_poses = poses[side][branch]
        before.append(takeoffs[best] - leg_poses.over[i])
        after.append(landings[best] - leg_poses.over[j])
        first = leg_poses.angles[i]
        angles.append([first, first + _wrap(leg_poses.angles[j] - first)])
        branches.append(BRANCHES[branch])
    return Leap(
        takeoffs[best],
        landings[best],
        speed,
        duration,
        np.array(before),
        np.array(after),
        patches,
        tuple(branches),
        np.array(angles),
        float(slack),
    )


def _select_takeoff(choices: Sequence[Sequence[_PosePair | None]]) -> tuple[int, float]:
    """Return the take-off place whose tightest leg has most slack, and that slack; -1 without."""
    best, slack = -1, -np.inf
    for k in range(len(TAKEOFF_OFFSETS)):
        at_takeoff = [matches[k] for matches in choices]
        min_slack = min((c[0] for c in at_takeoff if c is not None), default=-np.inf)
        if all(c is not None for c in at_takeoff) and min_slack > slack:
            best, slack = k, min_slack
    return best, slack


def _match_poses(
    scene: ModuleScene,
    side: int,
    poses: Sequence[_LegPoses],
    *,
    speeds: tuple[Array, Array],
    duration: float,
    levels: tuple[int, int],
    patches: tuple[int, int],
    centres: tuple[Array, Array],
    ends: tuple[Array, Array],
) -> list[_PosePair | None]:
    """Return slack, branch, and poses at take-off and landing for each take-off place, or None."""
    limit = scene.module.max_joint_speed
    best: list[_PosePair | None] = [None] * len(centres[0])
    for branch, branch_poses in enumerate(poses):
        speed_use = [np.abs(branch_poses.jacobian @ v).max(axis=1) / limit for v in speeds]
        rows = [
            np.flatnonzero((branch_poses.level == level) & (f <= SPEED_FRACTION))
            for level, f in zip(levels, speed_use, strict=True)
        ]
        if not len(rows[0]) or not len(rows[1]):
            continue
        # Footholds on their patches, with the box at rest at start and goal over them
        foothold_masks = []
        limb = build_leg(0, side, 1, BRANCHES[branch])
        for row, patch, centre, rest_centre, margin in zip(
            rows, patches, centres, ends, (APPROACH_MARGIN, RANGE_MARGIN), strict=True
        ):
            feet = centre[:, None] - branch_poses.over[row]  # (A, n, 3)
            is_foothold = scene.patches[patch].contains(feet, EDGE_MARGIN)
            half = float(abs(SIDE_NORMALS[side]) @ scene.box_size[0] / 2)
            offsets = rest_centre - feet
            is_foothold &= -offsets @ SIDE_NORMALS[side] >= half + FACE_CLEARANCE
            footholds = np.argwhere(is_foothold)
            _, is_feasible = compute_poses(scene, limb, offsets[is_foothold], margin)
            is_foothold[tuple(footholds[~is_feasible].T)] = False
            foothold_masks.append(is_foothold)
        joint_travel = np.abs(
            _wrap(branch_poses.angles[rows[1]][None] - branch_poses.angles[rows[0]][:, None])
        ).max(-1)
        utilisation = np.maximum(speed_use[0][rows[0]][:, None], speed_use[1][rows[1]][None])
        utilisation = np.maximum(
            utilisation, joint_travel / (limit * duration) * SPEED_FRACTION / TURN_FRACTION
        )
        for k in range(len(best)):
            i, j = np.flatnonzero(foothold_masks[0][k]), np.flatnonzero(foothold_masks[1][k])
            if not len(i) or not len(j):
                continue
            sub_utilisation = utilisation[np.ix_(i, j)]
            argmin = np.unravel_index(int(np.argmin(sub_utilisation)), sub_utilisation.shape)
            slack = SPEED_FRACTION - float(sub_utilisation[argmin])
            incumbent = best[k]
            if slack >= 0 and (incumbent is None or slack > incumbent[0]):
                best[k] = slack, branch, int(rows[0][i[argmin[0]]]), int(rows[1][j[argmin[1]]])
    return best
