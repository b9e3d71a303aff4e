"""Refinement of bracing postures for robots whose motors hardly hold them.

A large shift of the body over the standing legs changes their angles. The linear program of
`lift_torque.py` with the Jacobians of the unshifted body is then too optimistic. Postures of weak
robots are therefore evaluated again with exact kinematics of the shifted body. A random local
search improves the best: toes are perturbed about the incumbent, mirrored legs alike, with a step
size that decreases geometrically.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.lift_torque import compute_shifted_utilisation
from climbplan.robots.urdf.proposal.posture_quality import evaluate_postures
from climbplan.robots.urdf.proposal.postures import (
    MIN_REACH_MARGIN,
    LeggedPosture,
    LegModel,
    are_clear_of_body,
    rate_brace,
)

_MAX_REEVALUATED = 16  # postures with the smallest utilisation
_NUM_STARTS = 3  # of which the local search begins
_NUM_PERTURBATIONS = 32  # of each start
_PERTURBATION_RANGE = (0.06, 0.015)  # of reach, from the first to the last
_SUFFICIENT_MARGIN = 0.06  # [m] of reach margin, beyond which more has no value
_MAX_UTILISATION = 1.4  # of a start of the local search

IsClear = Callable[[Array, LeggedPosture], bool]
"""Whether a posture with links at points (N, P, 3) collides with nothing."""


def refine_braces(
    legs: LegModel,
    candidates: list[LeggedPosture],
    friction: float,
    max_shift: float,
    is_clear: IsClear,
) -> tuple[list[LeggedPosture], float]:
    """Return postures that hold with any one limb lifted, by exact kinematics.

    Args:
        legs: The legs, in a frame about the centre of mass.
        candidates: Postures with utilisation and shift by the Jacobians of the unshifted body.
        friction: Coefficient that may be used.
        max_shift: Largest shift of the body [m].
        is_clear: Whether a posture keeps clear of walls and of the robot itself.

    Returns:
        The postures, best first, and the smallest utilisation found; infinite without candidates.
    """
    search = _LocalSearch(legs, friction, max_shift, is_clear)
    by_utilisation = sorted(candidates, key=lambda posture: posture.utilisation)
    postures = [search.evaluate(posture, np.inf) for posture in by_utilisation[:_MAX_REEVALUATED]]
    postures.sort(key=_score_posture, reverse=True)
    rng = np.random.default_rng(0)
    starts = [start for start in postures[:_NUM_STARTS] if start.utilisation < _MAX_UTILISATION]
    postures += [search.improve(start, rng) for start in starts]
    utilisation = min((posture.utilisation for posture in postures), default=np.inf)
    holding = [posture for posture in postures if posture.utilisation < 1]
    return sorted(holding, key=_score_posture, reverse=True), utilisation


def _score_posture(posture: LeggedPosture) -> float:
    """Return the unused torque fraction times the useful reach margin; the excess if too weak."""
    if posture.utilisation < 1:
        return min(posture.reach_margin, _SUFFICIENT_MARGIN) * (1 - posture.utilisation)
    return 1 - posture.utilisation


class _LocalSearch:
    """A random local search over toe positions on two walls."""

    def __init__(
        self, legs: LegModel, friction: float, max_shift: float, is_clear: IsClear
    ) -> None:
        self.legs, self.friction = legs, friction
        self.max_shift, self.is_clear = max_shift, is_clear
        self.normal = legs.build_wall_normals()
        self.worst_lifted = 0  # limb of the last evaluation, which ends the next one the earliest

    def evaluate(self, posture: LeggedPosture, cutoff: float) -> LeggedPosture:
        """Return a posture with its utilisation by exact kinematics, cut short above `cutoff`."""
        legs = self.legs
        result = compute_shifted_utilisation(
            legs.chain,
            (legs.lower, legs.upper),
            posture.angles,
            legs.build_stance(
                posture.angles, posture.toes, self.normal, self.friction, self.max_shift
            ),
            cutoff,
            self.worst_lifted,
        )
        self.worst_lifted = result.worst_lifted
        return rate_brace(posture, result.utilisation, result.shift)

    def improve(self, posture: LeggedPosture, rng: np.random.Generator) -> LeggedPosture:
        """Return the best posture of a chain of perturbations, each about the incumbent."""
        for spread in np.geomspace(*_PERTURBATION_RANGE, _NUM_PERTURBATIONS):
            candidate = self._perturb(posture, float(spread), rng)
            if candidate is None:
                continue
            # A utilisation above the cutoff cannot be better, whatever the reach margin
            score = _score_posture(posture)
            cutoff = posture.utilisation
            if score > 0:
                cutoff = 1 - score / min(candidate.reach_margin, _SUFFICIENT_MARGIN)
            evaluated = self.evaluate(candidate, cutoff) if cutoff > 0 else posture
            if _score_posture(evaluated) > score:
                posture = evaluated
        return posture

    def _perturb(
        self, posture: LeggedPosture, spread: float, rng: np.random.Generator
    ) -> LeggedPosture | None:
        """Return the posture with perturbed toes; None where they are out of reach or collide.

        spread: standard deviation of the perturbation, as a fraction of reach.
        """
        legs, toes = self.legs, posture.toes.copy()
        half = 0.5 * posture.gap + spread * legs.reach.min() * rng.standard_normal()
        done: set[int] = set()
        for limb, twin in enumerate(legs.mirrored_legs):
            if twin in done:
                toes[limb, 1:] = toes[twin, 1:]
                continue
            toes[limb, 1:] += spread * legs.reach[limb] * rng.standard_normal(2)
            done.add(limb)
        toes[:, 0] = -self.normal[:, 0] * half
        chain = replace(legs.chain, posture=posture.angles)
        solution = chain.inverse(toes[None], legs.lower, legs.upper)
        if not solution.valid.all():
            return None
        angles = solution.best()
        quality = evaluate_postures(chain, angles, np.zeros((len(toes), 3)), legs.limits)
        margin = float(quality.reach_margin.min())
        perturbed = replace(posture, angles=angles[0], toes=toes, reach_margin=margin, gap=2 * half)
        if margin < MIN_REACH_MARGIN or not are_clear_of_body(legs, quality.points).all():
            return None
        return perturbed if self.is_clear(quality.points[0], perturbed) else None
