"""Bracing postures whose toes are drawn, for robots that brace in no posture of the grid.

The grid has all toes as far below their first joints, for their reach, and as far out to front or
rear. A humanoid braces with hands above its shoulders and feet before its hips, or otherwise: for
each pair of limbs the height of toes on the walls is drawn, and how far they are ahead, most of
that in common with the other pairs.
"""

from __future__ import annotations

import numpy as np

from climbplan.robots.urdf.proposal.postures import Braced, Legs, reached_angles

_DRAWN = 2500
_LOOKED = 300  # of the roomiest, whose forces are looked at
_WIDE = (0.1, 0.95)  # shares of reach that walls are from first joints
_AHEAD = 0.4  # of reach, of all toes
_APART = 0.3  # of reach, of each pair besides
_HIGH = (-0.8, 0.6)  # of reach above first joints


def drawn_braces(legs: Legs, clearance: float) -> Braced:
    """Postures between walls; clearance: [m] of the body from them. Always the same ones."""
    rng = np.random.default_rng(0)
    reach, hips = legs.reach, legs.hips
    sides = np.where(legs.outward[:, 0] == 0, 1.0, legs.outward[:, 0])
    half = np.abs(hips[:, 0]).max() + rng.uniform(*_WIDE, _DRAWN) * float(reach.min())
    half = half[half > max(-legs.box[0][0], legs.box[1][0]) + clearance]
    count = len(half)
    ahead = rng.uniform(-_AHEAD, _AHEAD, count)
    toes = np.empty((count, len(hips), 3))
    done: set[int] = set()
    for limb, other in enumerate(legs.mirror):
        if other in done:
            toes[:, limb] = toes[:, other]
            continue
        out = ahead + rng.uniform(-_APART, _APART, count)
        toes[:, limb, 1] = hips[limb, 1] + out * reach[limb]
        toes[:, limb, 2] = hips[limb, 2] + rng.uniform(*_HIGH, count) * reach[limb]
        done.add(limb)
    toes[..., 0] = sides * half[:, None]
    anyhow = np.zeros(len(hips), bool)  # knees may be below toes
    angles, reached = reached_angles(legs, toes, np.zeros((len(hips), 3)), anyhow)
    return Braced.at(legs, toes, angles, reached, clearance, _LOOKED)
