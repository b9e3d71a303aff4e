"""Workspace of legs by sampling: balls for the posture planner.

Neither ball is exact. `reach` is an inner estimate of the farthest distance, 0.97 of the farthest
sampled toe, and only a necessary condition: a toe within it may still be out of reach. The
intersection of both balls is meant as an inner set: all its sampled points about the stance are
reachable within the joint bounds, points between them are assumed to be. Every planned posture is
checked with exact inverse kinematics, and planned again with smaller balls if that fails.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_NUM_SAMPLES = 4000  # postures of every leg
_REACH_RATIO = 0.97  # of the farthest sampled toe
_MAX_REACH_DIFFERENCE = 0.2  # relative, between similar legs
_RADII = np.arange(1, 13) * 0.025  # [m] of the sampled shells about the stance
_NUM_DIRECTIONS = 60
_BATCH = 2  # shells solved at once: toes out of reach take longest


def estimate_reach(chain: SerialChain, lower: Array, upper: Array) -> Array:
    """Return the largest distance (N,) of sampled toes from their legs' first joints, less 3 % [m].

    Args:
        chain: N legs of J joints.
        lower: Lower joint bounds (N, J) [rad].
        upper: Upper joint bounds (N, J) [rad].
    """
    fraction = np.random.default_rng(0).random((_NUM_SAMPLES, *lower.shape))
    points = chain.joint_points(lower + fraction * (upper - lower))
    distance = np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)
    return np.asarray(_REACH_RATIO * distance.max(axis=0))


def select_common_reach(farthest: Array) -> float:
    """Return one `reach` for legs (N,) [m]: the smallest, if all are similar.

    If they are not, as with arms and legs, the largest: it has to be a necessary condition for all.
    """
    smallest, largest = float(farthest.min()), float(farthest.max())
    return smallest if largest <= (1 + _MAX_REACH_DIFFERENCE) * smallest else largest


def measure_stance_radii(
    chain: SerialChain,
    stance: Array,
    reach: float,
    lower: Array,
    upper: Array,
    turns: Array | None = None,
) -> Array:
    """Return the radius (N,) of the largest reachable sampled ball about each standing toe [m].

    Args:
        chain: N legs of J joints.
        stance: Standing toes (N, 3) [m].
        reach: Points farther from the first joint are left out, as in planning [m].
        lower: Lower joint bounds (N, J) [rad].
        upper: Upper joint bounds (N, J) [rad].
        turns: Rotations (N, 3, 3) of last links to keep; None for any.
    """
    directions = _sample_sphere(_NUM_DIRECTIONS)  # (D, 3)
    radius = np.zeros(len(stance))
    complete = np.ones(len(stance), bool)  # legs of which all shells so far are fine
    for shells in np.split(_RADII, np.arange(_BATCH, len(_RADII), _BATCH)):
        toes = stance + shells[:, None, None, None] * directions[None, :, None, :]  # (R, D, N, 3)
        toes[:, :, ~complete] = np.nan  # what is farther out does not count
        beyond = np.linalg.norm(toes - chain.joint_zero[:, 0], axis=-1) > reach
        feasible = (chain.inverse(toes, lower, upper, turns).valid | beyond).all(axis=1)  # (R, N)
        for size, is_reached in zip(shells, feasible, strict=True):
            complete &= is_reached
            radius[complete] = size
        if not complete.any():
            break
    return radius


def _sample_sphere(count: int) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere (golden spiral)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    azimuth = np.pi * (1 + np.sqrt(5)) * index
    horizontal = np.sqrt(1 - height**2)
    return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), height], axis=1)
