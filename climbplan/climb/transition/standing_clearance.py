"""Collision tables of standing limbs for the search: terrain, body and other limbs.

For every limb on every foothold from every body pose, its links are clear of all solids and of the
body. For every pair of limbs, their capsules are clear of one another. The criteria are those of
the checks `limbs.axis_collision`, `limbs.collision` and `limbs.self_collision`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limb_pairs import compute_body_distances, find_standing_overlap
from climbplan.climb.clearance.limbs import (
    compute_link_clearances,
    compute_world_capsules,
    find_closest_link,
)
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.transition.scene import TransitionScene
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.self_clearance import compute_limb_clearance, list_clearance_pairs

_OVERLAP_TOLERANCE = 1e-6  # [m] that counts
_MIN_CLEARANCE = 1e-3  # [m] that capsules keep from one another, from the body and from solids


@dataclass
class StandingClearance:
    """Clearance of limbs on C footholds from B poses, where they are in reach."""

    scene: TransitionScene
    links: tuple[Capsules, ...]  # by foothold: (B, N, K) in the body frame
    terrain_clear: BoolArray  # (B, N, C) bool, limb collides with neither terrain nor body
    _pairs: IntArray = field(repr=False)
    _cache: dict[tuple[int, int, int, int], BoolArray] = field(default_factory=dict, repr=False)

    def find_clear_poses(self, state: tuple[int, ...]) -> BoolArray:
        """Find poses (B,) at which no two limbs collide; footholds below zero are left out.

        A limb out of reach counts as clear.
        """
        clear = np.ones(len(self.terrain_clear), bool)
        for (i, c), (k, d) in itertools.combinations(enumerate(state), 2):
            if c < 0 or d < 0:
                continue
            pair_clear = self._cache.get((i, c, k, d))
            if pair_clear is None:
                pair_clear = self._cache[i, c, k, d] = self._check_limb_pair(i, c, k, d)
            clear &= pair_clear
        return clear

    def _check_limb_pair(self, i: int, c: int, k: int, d: int) -> BoolArray:
        link_pairs = self._pairs[(self._pairs[:, [0, 2]] == [i, k]).all(axis=1)]
        if not len(link_pairs):
            return np.ones(len(self.terrain_clear), bool)
        first, second = self.links[c], self.links[d]
        combined = Capsules(
            np.stack([first.starts[:, i], second.starts[:, k]], axis=1),
            np.stack([first.ends[:, i], second.ends[:, k]], axis=1),
            np.stack([first.radius[i], second.radius[k]]),
            np.stack([first.link[i], second.link[k]]),
            np.stack([first.to_toe[i], second.to_toe[k]]),
        )
        pairs = link_pairs.copy()
        pairs[:, 0], pairs[:, 2] = 0, 1
        distance = compute_limb_clearance(combined, pairs).min(axis=-1)
        return np.asarray(np.isnan(distance) | (distance > _MIN_CLEARANCE))


def compute_standing_clearance(
    scene: TransitionScene, com: Array, rpy: Array, angles: Array
) -> StandingClearance:
    """Compute the tables for poses (B, 3), (B, 3) and angles (B, N, C, J), NaN if unreached."""
    robot, rotation = scene.robot, rotation_world_body(rpy)
    links = tuple(limb_capsules(robot, angles[:, :, c]) for c in range(angles.shape[2]))
    pairs, limb_pairs = list_clearance_pairs(robot, links[0])
    terrain_clear = []
    for capsules in links:
        distance = compute_link_clearances(scene, capsules.to_world(com, rotation), _MIN_CLEARANCE)
        clear = _is_clear(distance.min(axis=(-2, -1), initial=np.inf), _MIN_CLEARANCE)
        body_distance = compute_body_distances(robot, capsules, pairs)  # (B, P)
        for limb in range(robot.limb_count):
            rows = pairs[:, 0] == limb
            clear[:, limb] &= _is_clear(
                body_distance[:, rows].min(axis=-1, initial=np.inf), _MIN_CLEARANCE
            )
        terrain_clear.append(clear)
    return StandingClearance(scene, links, np.stack(terrain_clear, axis=2), limb_pairs)


def describe_collision(scene: TransitionScene, instants: Instants) -> str | None:
    """Describe the worst collision of standing limbs at instants; None without a collision."""
    robot = scene.robot
    pose = instants.com, instants.rpy, instants.toes, instants.normal
    if scene.terrain.link_solids:
        nearest = find_closest_link(scene, compute_world_capsules(scene, *pose))
        if nearest.distance < -_OVERLAP_TOLERANCE:
            k, limb = nearest.index
            where = instants.label(k, robot.limb_names)
            link = f"{robot.limb_names[limb]}'s {robot.joint_name(limb, nearest.link)}"
            name = scene.terrain.link_solids[nearest.solid].name
            return f"{where}, {link} would be {-1e3 * nearest.distance:.1f} mm deep in {name!r}"
    overlap = find_standing_overlap(scene, instants)
    return None if overlap is None else f"{overlap[1]}, {overlap[0].describe(robot)}"


def _is_clear(distance: Array, min_distance: float) -> BoolArray:
    """Return whether distances exceed a minimum; NaN, of limbs out of reach, counts as clear."""
    return np.asarray(np.isnan(distance) | (distance > min_distance))
