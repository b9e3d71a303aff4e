"""How limbs bend to brace between walls where bent as the robot stands none of them hold it.

Inverse kinematics takes the angles nearest to the posture of the robot file. A humanoid that stands
on its feet with its hands on walls braces between them with its knees and elbows elsewhere: it is
given a robot file of its own, whose posture is the one that it braces in. Toes are drawn on the
walls, each pair of limbs at its own height and as far ahead as it may be, and angles of each limb
from the best of many postures nearby. Those that hold the robot with any one limb lifted are moved
by exact kinematics, as braces of the grid are (`refining.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.braces import CLEARANCE, IN_HAND, SAFETY, WALLS
from climbplan.robots.urdf.proposal.holding import holding_share
from climbplan.robots.urdf.proposal.postures import (
    SHIFTED,
    Legs,
    Posture,
    best_of,
    clear_of_body,
    reached_angles,
)
from climbplan.robots.urdf.proposal.quality import quality_of
from climbplan.robots.urdf.proposal.refining import refined
from climbplan.robots.urdf.proposal.settled import Proposal, Settled

_DRAWN = 4000
_LOOKED = 300  # of the roomiest, whose forces are looked at
_MOVED = 4  # of the best, which are moved by exact kinematics
_WIDE = (0.1, 0.95)  # shares of reach that walls are from first joints
_AHEAD = 0.4  # of reach, of all toes
_APART = 0.3  # of reach, of each pair besides
_HIGH = (-0.8, 0.6)  # of reach above first joints
_GIVE = 0.12  # [rad] from joint bounds, for commands beyond what limbs give
_BESIDE = 0.01  # [m] that limbs keep from one another


def bending_proposals(found: Proposal, most: int) -> list[Proposal]:
    """The robot in up to `most` postures to brace in, best first; each has itself as its brace.

    Always the same ones.
    """
    own = found.settled
    normal = _normal(own.legs)
    far = SHIFTED[-1] * float(own.legs.reach.min())
    held = []
    for posture in _drawn(own):
        for mu in WALLS:
            use, shift = holding_share(
                posture.toes - own.center(posture.angles), normal,
                own.legs.chain.jacobian(posture.angles), own.legs.torque, own.legs.weight,
                _usable(mu), far,
            )  # fmt: skip
            if use < 1:
                score = posture.room * (1 - use)
                held.append(replace(posture, use=use, shift=shift, friction=mu, score=score))
                break
    held.sort(key=lambda posture: -posture.score)
    beside = own.beside()
    moved: list[Posture] = []
    for posture in [one for one in held if not own.touching(one)][:_MOVED]:
        moved += _moved(own, posture, beside, far)
    moved.sort(key=lambda posture: -posture.score)
    return [_bent(own, posture) for posture in moved[:most]]


def standing_in(bent: Proposal, stands: Proposal) -> Proposal:
    """The robot of one of `bending_proposals` with its toes where it stands on the ground.

    stands: the robot as it stands; the bent one has its body's origin elsewhere, as its limbs weigh
    elsewhere.
    """
    own = bent.settled
    (brace,) = bent.braces
    aside = own.center(stands.posture.angles) - own.center(brace.angles)
    robot = replace(bent.robot, stance_body=stands.robot.stance_body + aside)
    return replace(bent, robot=robot, posture=stands.posture)


def _usable(mu: float) -> float:
    return IN_HAND * mu / SAFETY


def _normal(legs: Legs) -> Array:
    """(N, 3) of the walls."""
    normal = np.zeros((len(legs.hips), 3))
    normal[:, 0] = -np.where(legs.outward[:, 0] == 0, 1.0, legs.outward[:, 0])
    return normal


def _drawn(own: Settled) -> list[Posture]:
    """Postures between walls, in reach and clear of walls and body, roomiest first.

    Toes in the frame of the chains.
    """
    legs = own.legs
    inner = replace(
        legs, lower=legs.lower + _GIVE, upper=np.maximum(legs.upper, legs.lower + 2 * _GIVE) - _GIVE
    )
    rng = np.random.default_rng(0)
    reach, hips = legs.reach, legs.hips
    half = np.abs(hips[:, 0]).max() + rng.uniform(*_WIDE, _DRAWN) * float(reach.min())
    half = half[half > max(-legs.box[0][0], legs.box[1][0]) + CLEARANCE]
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
    toes[..., 0] = -_normal(legs)[:, 0] * half[:, None]
    light = np.zeros((len(hips), 3))
    anyhow = np.zeros(len(hips), bool)  # knees may be below toes
    angles, reached = reached_angles(inner, toes, light, anyhow)
    quality = quality_of(legs.chain, angles, light, inner.limits)
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - CLEARANCE
    fine = reached & within & clear_of_body(legs, quality.points)
    return best_of(quality, angles, toes, fine, _LOOKED, 2 * half)


def _moved(
    own: Settled, posture: Posture, beside: Callable[[Array], Array] | None, far: float
) -> list[Posture]:
    """A posture and what is better nearby, by exact kinematics; toes from the centre of mass."""
    center = own.center(posture.angles)
    chain = own.legs.chain
    moved = replace(chain, joint_zero=chain.joint_zero - center, toe_zero=chain.toe_zero - center)
    low, high = own.legs.box
    legs = replace(own.legs, chain=moved, box=(low - center, high - center))

    def clear(points: Array, one: Posture) -> bool:
        if np.abs(points[:, :-1, 0]).max() >= one.gap / 2 - CLEARANCE or own.touching(one):
            return False
        return beside is None or bool(beside(one.angles[None])[0] > _BESIDE)

    begun = replace(posture, toes=posture.toes - center)
    return refined(legs, [begun], _usable(posture.friction), far, clear)[0]


def _bent(own: Settled, posture: Posture) -> Proposal:
    proposal = own.proposal(posture, walls=False)
    toes = proposal.robot.stance_body.copy()
    toes[:, 0] = np.sign(toes[:, 0]) * posture.gap / 2
    return replace(proposal, braces=(replace(posture, toes=toes),), lacks="")
