"""What a leg reaches, found by sampling: balls for the posture planner.

Neither ball is exact. `reach` is an inner estimate of the farthest distance (0.97 of the farthest
of the sampled toes), a necessary condition alone: a toe within it may still be out of reach. Where
both balls overlap is meant as an inner set: all its sampled points about the stance can be reached
within the joint bounds, points between them are taken on trust. Every posture planned with them is
put to the exact inverse kinematics, and planned again with smaller balls where that fails.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_POSTURES = 4000  # sampled of every leg
_FAR = 0.97  # of the farthest sampled toe
_ALIKE = 0.2  # by which the reach of legs may differ
_RADII = np.arange(1, 13) * 0.025  # [m] of the sampled shells about the stance
_DIRECTIONS = 60
_TOGETHER = 2  # shells asked about at once: toes out of reach take longest


def farthest_toes(chain: SerialChain, lower: Array, upper: Array) -> Array:
    """(N,) largest distance of a sampled toe from its leg's first joint [m], less a reserve."""
    share = np.random.default_rng(0).random((_POSTURES, *lower.shape))
    points = chain.joint_points(lower + share * (upper - lower))
    distance = np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)
    return np.asarray(_FAR * distance.max(axis=0))


def common_reach(farthest: Array) -> float:
    """One `reach` for legs (N,) [m]: of that which reaches least, where all are alike.

    Where they are not, arms beside legs, of that which reaches farthest: the condition has to be a
    necessary one for all.
    """
    least, most = float(farthest.min()), float(farthest.max())
    return least if most <= (1 + _ALIKE) * least else most


def stance_balls(
    chain: SerialChain,
    stance: Array,
    reach: float,
    lower: Array,
    upper: Array,
    turns: Array | None = None,
) -> Array:
    """(N,) radius of the largest sampled ball about the stance (N, 3) that a leg reaches [m].

    turns: (N, 3, 3) of last links that are to lie in one way.
    Its points farther than `reach` from the first joint are left out, as planning does.
    """
    around = _directions(_DIRECTIONS)  # (D, 3)
    radius = np.zeros(len(stance))
    whole = np.ones(len(stance), bool)  # legs of which all shells so far are fine
    for shells in np.split(_RADII, np.arange(_TOGETHER, len(_RADII), _TOGETHER)):
        toes = stance + shells[:, None, None, None] * around[None, :, None, :]  # (R, D, N, 3)
        toes[:, :, ~whole] = np.nan  # what is farther out does not count
        beyond = np.linalg.norm(toes - chain.joint_zero[:, 0], axis=-1) > reach
        fine = (chain.inverse(toes, lower, upper, turns).valid | beyond).all(axis=1)  # (R, N)
        for size, met in zip(shells, fine, strict=True):
            whole &= met
            radius[whole] = size
        if not whole.any():
            break
    return radius


def _directions(count: int) -> Array:
    """Unit vectors spread evenly over the sphere (golden spiral)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    turn = np.pi * (1 + np.sqrt(5)) * index
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
