"""Search for stances of robots with arms above their legs: feet on ground, hands on two walls.

The grid has feet about the hips and hands about the shoulders. The candidates with the largest
reach margin are kept if they hold the weight with any one limb lifted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.urdf.proposal.lift_torque import (
    TorqueDemand,
    compute_torque_utilisation,
    find_overloaded_joint,
)
from climbplan.robots.urdf.proposal.posture_quality import PostureQuality, evaluate_postures
from climbplan.robots.urdf.proposal.postures import (
    MIN_LIMB_CLEARANCE,
    LeggedPosture,
    LegModel,
    are_clear_of_body,
    rate_brace,
    select_best_postures,
    solve_toe_positions,
)
from climbplan.robots.urdf.workspace import select_common_reach

# Fractions of a limb's reach:
_FOOT_LOWERINGS = np.arange(0.6, 0.96, 0.07)  # feet below hips
_FOOT_OFFSETS = np.array([0.0, 0.08, 0.16, 0.24, 0.32])  # feet outward of hips
_WALL_DISTANCES = np.arange(0.35, 0.92, 0.08)  # walls from shoulders
_HAND_LOWERINGS = np.array([-0.2, 0.0, 0.2, 0.4, 0.6])  # hands below shoulders
_HAND_OFFSETS = np.array([0.0, 0.25, 0.5])  # hands before shoulders
_MAX_SHIFT_RATIO = 0.25  # shift of the body
_MAX_REACH_RATIO = 0.93  # toes from first joints
_MIN_LINK_HEIGHT = 0.05  # links above the feet
_NUM_FEET = 2  # that bear the weight
_HAND_FORCE = 0.1  # of the weight, that a hand pushes
_MAX_FORCE_CHECKS = 120  # best postures whose forces are computed


class _ToeGrid(NamedTuple):
    """Candidate toes of N limbs."""

    toes: Array  # (C, N, 3) [m]
    level: Array  # (C,) height of the feet [m]
    half: Array  # (C,) half of the distance between the walls [m]


def search_wall_supported_stances(
    legs: LegModel,
    is_arm: BoolArray,
    compute_center: Callable[[Array], Array],
    clearance: float,
    friction: float,
    compute_clearance: Callable[[Array], Array] | None = None,
) -> tuple[list[LeggedPosture], TorqueDemand]:
    """Search for stances with feet on the ground and hands on walls.

    Args:
        legs: The limbs.
        is_arm: (N,) limbs whose ends are on walls.
        compute_center: Centre of mass (3,) at angles (N, J), frame of the chains [m].
        clearance: Distance of the body and elbows from the walls [m].
        friction: Coefficient that may be used.
        compute_clearance: Distance between limbs (C,) [m] at angles (C, N, J); None without
            collision geometry.

    Returns:
        Stances that hold with any one limb lifted, best first, toes in the frame of the chains;
        and the smallest utilisation of any stance.
    """
    reach, hips = legs.reach, legs.hips
    toes, level, half = _enumerate_toes(legs, is_arm, clearance)
    sides = legs.wall_sides
    normal = np.where(is_arm[:, None], -sides[:, None] * [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    force = normal * np.where(is_arm, _HAND_FORCE, 1 / _NUM_FEET)[:, None] * legs.weight
    angles, reached = solve_toe_positions(legs, toes, force, ~is_arm)
    quality = evaluate_postures(legs.chain, angles, force, legs.limits)
    height = quality.points[..., :-1, 2].min(axis=-1) - level[:, None]
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - clearance
    max_reach = _MAX_REACH_RATIO * np.minimum(reach, select_common_reach(reach))
    feasible = reached & (np.linalg.norm(toes - hips, axis=-1) < max_reach) & within
    feasible &= are_clear_of_body(legs, quality.points) & (height > _MIN_LINK_HEIGHT * reach)
    if compute_clearance is not None:
        feasible &= (compute_clearance(angles) > MIN_LIMB_CLEARANCE)[:, None]
    stances, demand = [], TorqueDemand(np.inf)
    max_shift = _MAX_SHIFT_RATIO * float(reach.min())
    for posture in select_best_postures(
        quality, angles, toes, feasible, _MAX_FORCE_CHECKS, 2 * half
    ):
        centred = posture.toes - compute_center(posture.angles)
        stance = legs.build_stance(posture.angles, centred, normal, friction, max_shift)
        utilisation, shift = compute_torque_utilisation(stance)
        if utilisation < demand.utilisation:
            demand = TorqueDemand(utilisation)
            if utilisation >= 1:
                demand = find_overloaded_joint(utilisation, stance)
        if utilisation < 1:
            stances.append(rate_brace(posture, utilisation, shift))
    complete = feasible.all(axis=1)
    if not complete.any():
        return sorted(stances, key=lambda posture: -posture.score), TorqueDemand()
    if np.isinf(demand.utilisation) and not (quality.score[complete].min(axis=1) > 0).any():
        demand = _find_weakest_joint(legs, quality, angles, force, complete)
    return sorted(stances, key=lambda posture: -posture.score), demand


def _enumerate_toes(legs: LegModel, is_arm: BoolArray, clearance: float) -> _ToeGrid:
    """Return all combinations of feet on the ground and hands on walls outside of the body."""
    reach, hips, sides = legs.reach, legs.hips, legs.wall_sides
    grids = _FOOT_LOWERINGS, _FOOT_OFFSETS, _WALL_DISTANCES, _HAND_LOWERINGS, _HAND_OFFSETS
    low, out, wide, below, ahead = (x.ravel() for x in np.meshgrid(*grids, indexing="ij"))
    half = np.abs(hips[is_arm, 0]).max() + wide * float(reach[is_arm].min())
    body_half = np.maximum(-legs.body_box[0][0], legs.body_box[1][0]) + clearance
    keep = half > body_half
    low, out, half, below, ahead = (x[keep] for x in (low, out, half, below, ahead))
    feet = np.empty((len(low), len(hips), 3))
    feet[..., 0] = hips[:, 0] + sides * out[:, None] * reach
    feet[..., 1] = hips[:, 1]
    level = (hips[~is_arm, 2] - low[:, None] * reach[~is_arm]).max(axis=1)
    feet[..., 2] = level[:, None]
    hands = np.empty_like(feet)
    hands[..., 0] = sides * half[:, None]
    hands[..., 1] = hips[:, 1] + ahead[:, None] * reach
    hands[..., 2] = hips[:, 2] - below[:, None] * reach
    return _ToeGrid(np.where(is_arm[:, None], hands, feet), level, half)


def _find_weakest_joint(
    legs: LegModel, quality: PostureQuality, angles: Array, force: Array, complete: BoolArray
) -> TorqueDemand:
    """Return the demand of the best posture where motors are too weak for both feet together.

    complete: (C,) candidates of which all limbs are feasible; at least one is.
    """
    utilisation = quality.utilisation[complete]
    best = int(np.argmin(utilisation.max(axis=1)))
    limb = int(np.argmax(utilisation[best]))
    jacobian = legs.chain.jacobian(angles[complete][best])
    needed = np.abs(np.einsum("nij,ni->nj", jacobian, force))[limb]
    joint = int(np.argmax(needed / legs.torque[limb]))
    return TorqueDemand(float(utilisation[best, limb]), limb, joint, float(needed[joint]))
