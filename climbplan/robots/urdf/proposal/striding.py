"""How a robot may stand to walk at speed: by the room that its toes have while others bear it.

`walking_body` gives all toes boxes of one size, in which each leg bears its part of the weight. A
posture that is roomy for one step at a time may leave them little: its toes may be far to one side
of the centre of mass, or just out of each other's way. Here toes are looked for on the grid of
`leaning_postures`, and of the best by a first look each has its boxes measured. What counts is
their least extent, less where motors are at their limits, and less how far the centre of mass is
from the lines between the toes that a trot stands on: so far it falls aside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.leaning import reaching_under
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.proposing import LYING, legs_of, settled
from climbplan.robots.urdf.proposal.settled import Proposal, Settled
from climbplan.robots.urdf.toe_boxes import borne, toe_boxes
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.schema.robots.leg_pairs import in_pairs

_EXTENT = np.array([1.0, 0.5, 0.4])  # of boxes along, across and up, that count alike
_BESIDE = 0.25  # of a metre of box, that a metre of the centre of mass beside the diagonals costs
_STRONG = 1.2  # times its part of the weight, that each leg holds as it stands
_MEASURED = 20  # of the best by a first look


@dataclass(frozen=True)
class _Stand:
    """A posture in walking's axes, pairs from front to hind."""

    posture: Posture
    order: list[int]
    center: Array  # (3,) [m], frame of the chains
    toes: Array  # (N, 3) from it [m]
    holds: float  # upright, of the leg that is weakest for its part [N]
    part: float  # of the weight, that it bears [N]
    beside: float  # of the centre of mass from the diagonals [m]

    @property
    def strength(self) -> float:
        """Times its part of the weight, that the weakest leg holds."""
        return self.holds / self.part

    def worth(self, extent: float) -> float:
        """Of boxes of such an extent [m]."""
        return extent * (1 - 1 / self.strength) - _BESIDE * self.beside


def walking_proposals(found: Proposal, most: int) -> tuple[list[Proposal], str]:
    """The robot in up to `most` postures to walk at speed in, best first; and why in no others.

    A robot that stands with its hands on walls goes on hands and feet. What it braces in between
    walls is not looked for.
    """
    ways = [found.settled] if not found.posture.gap else list(_lying(found))
    out: list[Proposal] = []
    lacks = []
    for way in ways:
        postures, lack = striding_postures(way, most - len(out))
        out += [way.proposal(posture, walls=False) for posture in postures]
        lacks.append(f"with the base's {way.draft.up} up {lack}" if lack else "")
        if len(out) == most:
            break
    return out, "; ".join(lack for lack in lacks if lack)


def _lying(found: Proposal) -> Iterator[Settled]:
    draft = found.draft
    for axes in LYING:
        yield settled(legs_of(draft.urdf, draft.packages, axes, draft.asked))


def striding_postures(own: Settled, most: int) -> tuple[list[Posture], str]:
    """Postures on level ground with boxes of toes, best first, and what is lacking without any.

    Toes in the frame of the chains.
    """
    legs = own.legs
    reached = reaching_under(legs, own.beside(), None)
    stands = [one for posture in reached if (one := _stand(own, posture)) is not None]
    strong = [one for one in stands if one.strength > _STRONG]
    strong.sort(key=lambda one: -one.worth(one.posture.room))
    found: list[Posture] = []
    lack = ""
    for one in strong[:_MEASURED]:
        if own.touching(one.posture):
            continue
        posture, order = one.posture, one.order
        chain = replace(
            legs.chain,
            posture=posture.angles,
            joint_zero=legs.chain.joint_zero - one.center,
            toe_zero=legs.chain.toe_zero - one.center,
        )
        chain = chain.turned(TO_WALKING).ordered(order)
        limits = legs.lower[order], legs.upper[order], legs.torque[order]
        boxes = toe_boxes(chain, one.toes, *limits, legs.weight)
        if isinstance(boxes, str):
            lack = lack or boxes
            continue
        worth = one.worth(float((boxes.half / _EXTENT).min()))
        found.append(replace(posture, score=worth, use=1 / one.strength))
    if found:
        return sorted(found, key=lambda posture: -posture.score)[:most], ""
    if not reached:
        lack = "no posture in reach keeps limbs out of each other's way with room about the toes"
    elif not stands:
        lack = (
            f"{len(reached)} postures have room about their toes, and none has toes in pairs "
            "before and behind its centre of mass"
        )
    elif not strong:
        best = max(stands, key=lambda one: one.strength)
        lack = (
            f"a leg holds at most {best.holds:.0f} N upright of the {_STRONG * best.part:.0f} N "
            f"asked for, {_STRONG:g} times its part of the weight, in {len(stands)} postures"
        )
    return [], lack or f"parts touch in all of {len(strong)} postures that would hold"


def _stand(own: Settled, posture: Posture) -> _Stand | None:
    """None where toes are no pairs about the centre of mass."""
    legs, center = own.legs, own.center(posture.angles)
    toes = (posture.toes - center) @ TO_WALKING.T
    order = in_pairs(toes.tolist())
    if order is None:
        return None
    toes = toes[order]
    if not toes[:2, 0].mean() > 0 > toes[-2:, 0].mean():
        return None
    upward = np.abs(legs.chain.jacobian(posture.angles)[order][:, 2])  # (N, J)
    holds = (legs.torque[order] / np.maximum(upward, 1e-9)).min(axis=1)
    part = borne(toes) * legs.weight
    leg = int(np.argmin(holds / part))
    beside = _beside_diagonals(toes)
    return _Stand(posture, order, center, toes, float(holds[leg]), float(part[leg]), beside)


def _beside_diagonals(toes: Array) -> float:
    """How far the centre of mass is from the lines between toes (N, 3) that stand together [m].

    Of four legs; more have three on the ground.
    """
    if len(toes) != 4:
        return 0.0
    front, rear = toes[:2, :2], toes[:1:-1, :2]
    along = rear - front
    away = np.abs(along[:, 0] * front[:, 1] - along[:, 1] * front[:, 0])
    return float((away / np.maximum(np.linalg.norm(along, axis=1), 1e-9)).max())
