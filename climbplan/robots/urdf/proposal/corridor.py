"""How a robot with arms above its legs may stand between walls: on its feet, hands on them.

Searched for as other postures are, on a grid of feet about hips and of hands about shoulders.
Of the roomiest, those remain that hold the weight with any one limb lifted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.urdf.proposal.holding import Lack, holding_share, lack_of
from climbplan.robots.urdf.proposal.postures import (
    BESIDE,
    Legs,
    Posture,
    best_of,
    clear_of_body,
    reached_angles,
)
from climbplan.robots.urdf.proposal.quality import quality_of
from climbplan.robots.urdf.workspace import common_reach

_LOW = np.arange(0.6, 0.96, 0.07)  # shares of reach that feet are below hips
_OUT = np.array([0.0, 0.08, 0.16, 0.24, 0.32])  # that they are further out
_WIDE = np.arange(0.35, 0.92, 0.08)  # that walls are from shoulders
_BELOW = np.array([-0.2, 0.0, 0.2, 0.4, 0.6])  # that hands are below them
_AHEAD = np.array([0.0, 0.25, 0.5])  # and before them
_FEET = 2  # that bear the weight
_PUSH = 0.1  # of the weight, that a hand pushes
_HELD = 120  # of the roomiest whose forces are looked at
_SHIFTED = 0.25  # of reach that the body may shift
_LONGEST = 0.93  # of reach, that a toe is from the first joint
_ABOVE = 0.05  # of reach that links stay above the feet


def corridor_postures(
    legs: Legs,
    arms: BoolArray,
    center: Callable[[Array], Array],
    clearance: float,
    mu: float,
    beside: Callable[[Array], Array] | None = None,
) -> tuple[list[Posture], Lack]:
    """The best postures, best first, and the least share of torque limits that one needs.

    Toes in the frame of the chains.

    arms: (N,) limbs whose ends are on walls; center: centre of mass of angles (N, J) [m];
    clearance: [m] of the body and elbows from walls; mu: friction coefficient that may be used;
    beside: room (C,) between limbs at angles (C, N, J) [m].
    """
    reach, hips, sign = legs.reach, legs.hips, legs.outward
    sides = np.where(sign[:, 0] == 0, 1.0, sign[:, 0])
    low, out, wide, below, ahead = (
        x.ravel() for x in np.meshgrid(_LOW, _OUT, _WIDE, _BELOW, _AHEAD, indexing="ij")
    )
    half = np.abs(hips[arms, 0]).max() + wide * float(reach[arms].min())
    room = np.maximum(-legs.box[0][0], legs.box[1][0]) + clearance
    keep = half > room
    low, out, half, below, ahead = (x[keep] for x in (low, out, half, below, ahead))
    feet = np.empty((len(low), len(hips), 3))
    feet[..., 0] = hips[:, 0] + sides * out[:, None] * reach
    feet[..., 1] = hips[:, 1]
    level = (hips[~arms, 2] - low[:, None] * reach[~arms]).max(axis=1)
    feet[..., 2] = level[:, None]
    hands = np.empty_like(feet)
    hands[..., 0] = sides * half[:, None]
    hands[..., 1] = hips[:, 1] + ahead[:, None] * reach
    hands[..., 2] = hips[:, 2] - below[:, None] * reach
    toes = np.where(arms[:, None], hands, feet)
    normal = np.where(arms[:, None], -sides[:, None] * [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    force = normal * np.where(arms, _PUSH, 1 / _FEET)[:, None] * legs.weight
    angles, reached = reached_angles(legs, toes, force, ~arms)
    quality = quality_of(legs.chain, angles, force, legs.limits)
    above = quality.points[..., :-1, 2].min(axis=-1) - level[:, None]
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - clearance
    most = np.minimum(reach, common_reach(reach))
    near = np.linalg.norm(toes - hips, axis=-1) < _LONGEST * most
    fine = reached & near & within & clear_of_body(legs, quality.points) & (above > _ABOVE * reach)
    if beside is not None:
        fine &= (beside(angles) > BESIDE)[:, None]
    found, lack = [], Lack(np.inf)
    for posture in best_of(quality, angles, toes, fine, _HELD, 2 * half):
        jacobian = legs.chain.jacobian(posture.angles)
        at = posture.toes - center(posture.angles)
        far = _SHIFTED * float(reach.min())
        use, shift = holding_share(at, normal, jacobian, legs.torque, legs.weight, mu, far)
        if use < lack.share:
            lack = Lack(use)
            if use >= 1:
                lack = lack_of(use, at, normal, jacobian, legs.torque, legs.weight, mu, far)
        if use < 1:
            score = posture.room * (1 - use)
            found.append(replace(posture, use=use, shift=shift, score=score))
    whole = fine.all(axis=1)
    if np.isinf(lack.share) and whole.any() and not (quality.score[whole].min(axis=1) > 0).any():
        # Too weak for the weight on their feet alone
        best = int(np.argmin(quality.use[whole].max(axis=1)))
        limb = int(np.argmax(quality.use[whole][best]))
        jacobian = legs.chain.jacobian(angles[whole][best])
        needed = np.abs(np.einsum("nij,ni->nj", jacobian, force))[limb]
        joint = int(np.argmax(needed / legs.torque[limb]))
        share = float(quality.use[whole][best, limb])
        lack = Lack(share, limb, joint, float(needed[joint]))
    held = sorted(found, key=lambda posture: -posture.score)
    return held, lack if whole.any() else Lack()
