"""Search for stances on level ground of robots whose weaker limbs cannot bear an equal load.

A humanoid on hands and feet has arms that hold it only with the body over its feet. The grid
therefore lets front and rear toes reach far under the body, each pair on its own. The candidates
with the largest reach margin are kept if they hold the weight with any one limb lifted, the body
shifted over the others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.lift_torque import compute_shifted_utilisation
from climbplan.robots.urdf.proposal.posture_quality import evaluate_postures
from climbplan.robots.urdf.proposal.postures import (
    MIN_LIMB_CLEARANCE,
    MIN_LINK_HEIGHT,
    LeggedPosture,
    LegModel,
    are_clear_of_body,
    rate_brace,
    select_best_postures,
    solve_toe_positions,
)

# Fractions of a limb's reach:
_LOWERINGS = np.arange(0.35, 0.93, 0.08)  # toes below first joints
_OUTWARD_OFFSETS = np.array([0.0, 0.1, 0.25])
_FORE_AFT_OFFSETS = np.array([-0.45, -0.3, -0.15, 0.0, 0.15])  # negative: under the body
_MAX_SHIFT_RATIO = 0.25  # shift of the body
_MAX_FORCE_CHECKS = 48  # best postures whose forces are computed
_MAX_UTILISATION = 1.0


def search_weight_shift_stances(
    legs: LegModel,
    compute_center: Callable[[Array], Array],
    friction: float,
    compute_clearance: Callable[[Array], Array] | None = None,
) -> list[LeggedPosture]:
    """Return stances that hold with any one limb lifted, best first.

    Args:
        legs: The limbs.
        compute_center: Centre of mass (3,) at angles (N, J), frame of the chains [m].
        friction: Coefficient that may be used.
        compute_clearance: Distance between limbs (C,) [m] at angles (C, N, J); None without
            collision geometry.
    """
    normal = np.zeros((len(legs.hips), 3))
    normal[:, 2] = 1.0
    stances, max_shift = [], _MAX_SHIFT_RATIO * float(legs.reach.min())
    for posture in search_ground_postures(legs, compute_clearance, _MAX_FORCE_CHECKS):
        toes = posture.toes - compute_center(posture.angles)
        utilisation, shift, _ = compute_shifted_utilisation(
            legs.chain,
            (legs.lower, legs.upper),
            posture.angles,
            legs.build_stance(posture.angles, toes, normal, friction, max_shift),
            _MAX_UTILISATION,
        )
        if utilisation < _MAX_UTILISATION:
            stances.append(rate_brace(posture, utilisation, shift))
    return sorted(stances, key=lambda posture: -posture.score)


def search_ground_postures(
    legs: LegModel, compute_clearance: Callable[[Array], Array] | None, max_count: int | None
) -> list[LeggedPosture]:
    """Return postures on level ground by their reach margin, whatever they bear; best first.

    Args:
        legs: The limbs.
        compute_clearance: Distance between limbs (C,) [m] at angles (C, N, J); None without
            collision geometry.
        max_count: How many to return at most; None for all.
    """
    reach, hips, sign = legs.reach, legs.hips, legs.outward_signs
    grids = _LOWERINGS, _OUTWARD_OFFSETS, _FORE_AFT_OFFSETS, _FORE_AFT_OFFSETS
    low, out, front, rear = (x.ravel() for x in np.meshgrid(*grids, indexing="ij"))
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = hips[:, 0] + sign[:, 0] * out[:, None] * reach
    fore = np.where(sign[:, 1] > 0, front[:, None], rear[:, None])
    toes[..., 1] = hips[:, 1] + sign[:, 1] * fore * reach
    level = (hips[:, 2] - low[:, None] * reach).max(axis=1)
    toes[..., 2] = level[:, None]
    no_force = np.zeros((len(hips), 3))
    angles, reached = solve_toe_positions(legs, toes, no_force)
    quality = evaluate_postures(legs.chain, angles, no_force, legs.limits)
    height = quality.points[..., :-1, 2].min(axis=-1) - toes[..., 2]
    feasible = (
        reached & are_clear_of_body(legs, quality.points) & (height > MIN_LINK_HEIGHT * reach)
    )
    if compute_clearance is not None:
        feasible &= (compute_clearance(angles) > MIN_LIMB_CLEARANCE)[:, None]
    count = len(toes) if max_count is None else max_count
    return select_best_postures(quality, angles, toes, feasible, count)
