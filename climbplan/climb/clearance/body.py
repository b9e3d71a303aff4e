"""Exact clearance of the moving body from obstacles, free regions and walls."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.raw_surface import compute_raw_body_distance
from climbplan.climb.gait.gait import interpolate_poses
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import FreeRegion

_BETWEEN = 1e-4  # [m] kept beyond the clearance from a scan, for poses between those checked
_STEPS = 12  # poses checked along a round


def hull_world(scene: MotionScene, com: Array, rpy: Array) -> Array:
    """Corners (..., 8, 3) of the body hull at poses (..., 3), exact rotation."""
    rotation = rotation_world_body(rpy)
    return com[..., None, :] + np.einsum("...ij,vj->...vi", rotation, scene.robot.body_hull)


def compute_body_shortfall(scene: MotionScene, rounds: Rounds) -> Array:
    """Compute the clearance that each round lacks, (M,) [m]; 0 where the required one is kept.

    A pose is clear of a choice if its hull lies in one of the choice's free regions.
    """
    return compute_poses_shortfall(scene, *interpolate_poses(rounds, np.linspace(0.0, 1.0, _STEPS)))


def compute_poses_shortfall(scene: MotionScene, com: Array, rpy: Array) -> Array:
    """The same of poses (M, S, 3), (M,) [m]."""
    corners = hull_world(scene, com, rpy)  # (M, S, 8, 3)
    keep = scene.spec.posture.body_clearance
    worst = np.zeros(len(com))
    for choice in scene.terrain.free_choices:
        distance = np.stack(
            [_compute_distance(free, corners) for free in choice]
        )  # (regions, M, S)
        worst = np.maximum(worst, (keep - distance.max(axis=0)).max(axis=1))
    if scene.terrain.scan is not None:
        raw = compute_raw_body_distance(scene.terrain.scan, corners, keep + _BETWEEN)
        worst = np.maximum(worst, (keep + _BETWEEN - raw).max(axis=1))
    return np.maximum(worst, 0.0)


def _compute_distance(free: FreeRegion, corners: Array) -> Array:
    """Least distance of all corners (..., V, 3) from the region's faces, negative outside."""
    return (free.b - corners @ free.A.T).min(axis=(-2, -1))
