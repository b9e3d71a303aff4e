"""Leaps that all four legs can do: take-off and landing found before any program is solved.

Poses of a leg on a grid of box centres over its foothold, with their Jacobians, are listed once.
Leaps are then drawn at random, and each leg looks for a pair of poses that has the speed at both
ends, turns from one into the other in the time of the flight, and serves start and goal as well.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.legs.gaits import patch_under
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.limbs import leg, limb_angles, limb_points
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, Scene
from climbplan.limms.scene.phases import Limb

HEIGHTS = np.arange(0.2, 0.72, 0.06)  # [m] of the box's centre over the ground at both ends
GRID = np.arange(-0.78, 0.79, 0.06)  # [m] of the box's centre over a foothold
FOOT_CLEARANCE = np.arange(-0.2, 0.75, 0.05)  # [m] of take-off from the start, towards the goal
DRAWS = 800
ENOUGH = 4
SPEED_SHARE = 0.9  # of joint speeds
SLOW_SHARE = 0.85  # of joint speeds times flight
EDGE = 0.04  # [m] of feet from edges
OWN_SIDE = 0.025  # [m]
GROUND_MARGIN = 0.1  # [rad] of joint ranges
CLOSING = 0.2  # [rad] of joint ranges where the latches close
ELBOW = 0.12  # [rad] bent at least
_TINY = 1e-5


@dataclass(frozen=True)
class Leap:
    """One leap: the box at take-off and landing, footholds before and after, branches."""

    takeoff: Array  # (3,) [m]
    landing: Array  # (3,)
    speed: Array  # (3,) at take-off [m/s]
    duration: float  # [s]
    before: Array  # (4, 3) [m]
    after: Array  # (4, 3)
    patches: tuple[int, int]
    branches: tuple[tuple[int, int, int], ...]
    angles: Array  # (4, 2, 6) at take-off and landing, without turns between [rad]
    slack: float  # of joint speeds, share


@dataclass(frozen=True)
class _Poses:
    """Poses of one leg in one branch."""

    over: Array  # (n, 3) centre - foothold [m]
    angles: Array  # (n, 6) [rad]
    jacobian: Array  # (n, 6, 3) [rad/m]
    level: IntArray  # (n,) number of the height


def find_leaps(
    scene: Scene, goal: Array, rng: np.random.Generator, deadline: float = np.inf
) -> list[Leap]:
    """Leaps from where the box starts towards its goal, those with most slack first.

    deadline: `time.monotonic` [s] after which no more are drawn.
    """
    start = scene.box_start[0]
    first = patch_under(scene, start, start[2])
    last = patch_under(scene, goal, goal[2])
    drop = scene.patches[first].height - scene.patches[last].height
    ways = goal[:2] - start[:2]
    far = float(np.linalg.norm(ways))
    along = np.array([*(ways / far), 0.0]) if far > 1e-6 else np.array([1.0, 0.0, 0.0])
    poses = [[_poses(scene, side, branch) for branch in BRANCHES] for side in range(4)]
    found: list[Leap] = []
    fastest = 0.45 * scene.module.max_joint_speed
    for _ in range(DRAWS):
        if time.monotonic() > deadline:
            break
        up, ahead = rng.uniform(-0.2, 0.6) * fastest, rng.uniform(0.4, 1.0) * fastest
        one, other = rng.integers(len(HEIGHTS), size=2)
        fall = up**2 + 2 * GRAVITY * (HEIGHTS[one] + drop - HEIGHTS[other])
        if fall <= 0:
            continue
        duration = float((up + np.sqrt(fall)) / GRAVITY)
        if ahead * duration < 0.35:
            continue
        leap = _leap(
            scene,
            poses,
            along * ahead + [0, 0, up],
            duration,
            (int(one), int(other)),
            (first, last),
            (start, goal),
            along,
        )
        if leap is not None:
            found.append(leap)
            if len(found) >= ENOUGH:
                break
    found.sort(key=lambda leap: -leap.slack)
    return found


def _poses(scene: Scene, side: int, branch: tuple[int, int, int]) -> _Poses:
    limb = leg(0, side, 1, branch)
    x, y, z = (m.ravel() for m in np.meshgrid(GRID, GRID, HEIGHTS, indexing="ij"))
    over = np.column_stack([x, y, z])
    half = float(abs(SIDE_NORMALS[side]) @ scene.box_size[0] / 2)
    over = over[-over @ SIDE_NORMALS[side] >= half + OWN_SIDE]
    angles, good = pose_of(scene, limb, over, GROUND_MARGIN)
    over, angles = over[good], angles[good]
    jacobian = np.zeros((len(over), 6, 3))
    for axis in range(3):
        moved, _ = pose_of(scene, limb, over + _TINY * np.eye(3)[axis], GROUND_MARGIN)
        jacobian[..., axis] = _wrapped(moved - angles) / _TINY
    level = np.rint((over[:, 2] - HEIGHTS[0]) / (HEIGHTS[1] - HEIGHTS[0])).astype(int)
    return _Poses(over, angles, jacobian, level)


def pose_of(scene: Scene, limb: Limb, over: Array, margin: float) -> tuple[Array, BoolArray]:
    """Angles (n, 6) of a leg with the box's centre at `over` (n, 3) from its foot, and whether it
    can stand so: in reach, in range, its links off ground and box as far as their ends tell."""
    feet = np.zeros_like(over)
    angles = np.zeros((len(over), 6))
    if not len(over):
        return angles, np.zeros(0, bool)
    angles, missing = limb_angles(scene, limb, over, feet, limb.branch)
    angles = _wrapped(angles)
    good = (missing <= 0) & (in_range(scene.module, angles, margin) <= 0)
    good &= np.abs(angles[:, 2]) > ELBOW
    points = limb_points(scene, limb, over, feet, angles).position
    radius = scene.module.radius
    good &= (points[:, 2:7, 2] >= radius).all(axis=1)
    half = scene.box_size[0] / 2 + radius
    for share in (0.0, 0.3, 0.6):  # from the elbow to the wrist
        point = points[:, 3] + share * (points[:, 5] - points[:, 3])
        good &= ~(np.abs(point - over) < half).all(axis=1)
    return angles, good


def _wrapped(angles: Array) -> Array:
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _leap(
    scene: Scene,
    poses: Sequence[Sequence[_Poses]],
    speed: Array,
    duration: float,
    levels: tuple[int, int],
    patches: tuple[int, int],
    ends: tuple[Array, Array],
    along: Array,
) -> Leap | None:
    """The leap with a drawn speed and drawn heights, if every leg can do it."""
    start = ends[0]
    ground = [scene.patches[k].height for k in patches]
    arriving = speed - np.array([0, 0, GRAVITY * duration])
    takeoffs = start + FOOT_CLEARANCE[:, None] * along
    takeoffs[:, 2] = ground[0] + HEIGHTS[levels[0]]
    landings = takeoffs + speed * duration
    landings[:, 2] = ground[1] + HEIGHTS[levels[1]]
    choices: list[list[tuple[float, int, int, int] | None]] = []
    for side in (1, 0, 2, 3):
        each = _pairs(
            scene,
            side,
            poses[side],
            (speed, arriving),
            duration,
            levels,
            patches,
            (takeoffs, landings),
            ends,
        )
        if all(choice is None for choice in each):
            return None
        choices.append(each)
    choices = [choices[1], choices[0], choices[2], choices[3]]
    best, slack = -1, -np.inf
    for k in range(len(FOOT_CLEARANCE)):
        own = [each[k] for each in choices]
        worst = min((c[0] for c in own if c is not None), default=-np.inf)
        if all(c is not None for c in own) and worst > slack:
            best, slack = k, worst
    if best < 0:
        return None
    picked = [each[best] for each in choices]
    before, after, angles, branches = [], [], [], []
    for side, choice in enumerate(picked):
        assert choice is not None
        _, branch, i, j = choice
        its = poses[side][branch]
        before.append(takeoffs[best] - its.over[i])
        after.append(landings[best] - its.over[j])
        angles.append([its.angles[i], its.angles[i] + _wrapped(its.angles[j] - its.angles[i])])
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


def _pairs(
    scene: Scene,
    side: int,
    poses: Sequence[_Poses],
    speeds: tuple[Array, Array],
    duration: float,
    levels: tuple[int, int],
    patches: tuple[int, int],
    centres: tuple[Array, Array],
    ends: tuple[Array, Array],
) -> list[tuple[float, int, int, int] | None]:
    """For each place of take-off: slack, branch, pose at take-off, pose at landing; or None."""
    limit = scene.module.max_joint_speed
    best: list[tuple[float, int, int, int] | None] = [None] * len(centres[0])
    for number, own in enumerate(poses):
        fast = [np.abs(own.jacobian @ v).max(axis=1) / limit for v in speeds]
        rows = [
            np.flatnonzero((own.level == level) & (f <= SPEED_SHARE))
            for level, f in zip(levels, fast, strict=True)
        ]
        if not len(rows[0]) or not len(rows[1]):
            continue
        # Footholds on their patches, and the box at rest at start and goal over them
        fits = []
        limb = leg(0, side, 1, BRANCHES[number])
        for row, patch, centre, rest, margin in zip(
            rows, patches, centres, ends, (CLOSING, GROUND_MARGIN), strict=True
        ):
            feet = centre[:, None] - own.over[row]  # (A, n, 3)
            stands = scene.patches[patch].contains(feet, EDGE)
            half = float(abs(SIDE_NORMALS[side]) @ scene.box_size[0] / 2)
            over = rest - feet
            stands &= -over @ SIDE_NORMALS[side] >= half + OWN_SIDE
            at = np.argwhere(stands)
            _, good = pose_of(scene, limb, over[stands], margin)
            stands[tuple(at[~good].T)] = False
            fits.append(stands)
        turn = np.abs(_wrapped(own.angles[rows[1]][None] - own.angles[rows[0]][:, None])).max(-1)
        use = np.maximum(fast[0][rows[0]][:, None], fast[1][rows[1]][None])
        use = np.maximum(use, turn / (limit * duration) * SPEED_SHARE / SLOW_SHARE)
        for k in range(len(best)):
            i, j = np.flatnonzero(fits[0][k]), np.flatnonzero(fits[1][k])
            if not len(i) or not len(j):
                continue
            part = use[np.ix_(i, j)]
            least = np.unravel_index(int(np.argmin(part)), part.shape)
            slack = SPEED_SHARE - float(part[least])
            here = best[k]
            if slack >= 0 and (here is None or slack > here[0]):
                best[k] = slack, number, int(rows[0][i[least[0]]]), int(rows[1][j[least[1]]])
    return best
