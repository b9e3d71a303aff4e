"""How a robot may stand on level ground whose weaker limbs cannot bear their share of its weight.

A humanoid on hands and feet has arms that hold it only with the body over its feet. Toes are
searched for on a grid in which front and rear limbs reach as far under the body as they may, each
their own way. Of the roomiest, those remain that hold the weight with any one limb lifted, the body
shifted over the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.holding import moved_share
from climbplan.robots.urdf.proposal.postures import (
    ABOVE,
    BESIDE,
    Legs,
    Posture,
    best_of,
    clear_of_body,
    reached_angles,
)
from climbplan.robots.urdf.proposal.quality import quality_of

_LOW = np.arange(0.35, 0.93, 0.08)  # shares of reach that toes are below first joints
_OUT = np.array([0.0, 0.1, 0.25])  # that they are further out
_UNDER = np.array([-0.45, -0.3, -0.15, 0.0, 0.15])  # and further out to front or rear
_LOOKED = 48  # of the roomiest whose forces are looked at
_SHIFTED = 0.25  # of reach that the body may shift
_ENOUGH = 1.0  # of the torque limits


def leaning_postures(
    legs: Legs,
    center: Callable[[Array], Array],
    mu: float,
    beside: Callable[[Array], Array] | None = None,
) -> list[Posture]:
    """The best postures, best first; toes in the frame of the chains.

    center: centre of mass of angles (N, J) [m]; mu: friction coefficient that may be used;
    beside: room (C,) between limbs at angles (C, N, J) [m].
    """
    normal = np.zeros((len(legs.hips), 3))
    normal[:, 2] = 1.0
    found, far = [], _SHIFTED * float(legs.reach.min())
    for posture in reaching_under(legs, beside, _LOOKED):
        at = posture.toes - center(posture.angles)
        bounds = legs.lower, legs.upper
        use, shift = moved_share(
            legs.chain, bounds, posture.angles, at, normal, legs.torque, legs.weight, mu, far,
            _ENOUGH,
        )  # fmt: skip
        if use < _ENOUGH:
            score = posture.room * (1 - use)
            found.append(replace(posture, use=use, shift=shift, score=score))
    return sorted(found, key=lambda posture: -posture.score)


def reaching_under(
    legs: Legs, beside: Callable[[Array], Array] | None, most: int | None
) -> list[Posture]:
    """The roomiest postures on level ground, whatever they bear; best first.

    beside: room (C,) between limbs at angles (C, N, J) [m].
    """
    reach, hips, sign = legs.reach, legs.hips, legs.outward
    low, out, front, rear = (
        x.ravel() for x in np.meshgrid(_LOW, _OUT, _UNDER, _UNDER, indexing="ij")
    )
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = hips[:, 0] + sign[:, 0] * out[:, None] * reach
    under = np.where(sign[:, 1] > 0, front[:, None], rear[:, None])
    toes[..., 1] = hips[:, 1] + sign[:, 1] * under * reach
    level = (hips[:, 2] - low[:, None] * reach).max(axis=1)
    toes[..., 2] = level[:, None]
    light = np.zeros((len(hips), 3))
    angles, reached = reached_angles(legs, toes, light)
    quality = quality_of(legs.chain, angles, light, legs.limits)
    above = quality.points[..., :-1, 2].min(axis=-1) - toes[..., 2]
    fine = reached & clear_of_body(legs, quality.points) & (above > ABOVE * reach)
    if beside is not None:
        fine &= (beside(angles) > BESIDE)[:, None]
    return best_of(quality, angles, toes, fine, len(toes) if most is None else most)
