"""Bracing postures of robots whose motors hardly hold them, looked at with the body where it goes.

A body that shifts over the legs that stay bends them otherwise: the linear program of `holding.py`
with Jacobians of the unshifted body promises too much where shifts are large beside the legs. So
postures of weak robots are looked at again by exact kinematics of the shifted body. What is best
then is moved by drawing toes nearby, mirrored alike, each draw about the best so far, less and less
far away: what the grid has missed between its places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.holding import moved_share
from climbplan.robots.urdf.proposal.postures import (
    LEAST_ROOM,
    Legs,
    Posture,
    clear_of_body,
)
from climbplan.robots.urdf.proposal.quality import quality_of

_LOOKED = 16  # postures looked at again, those with most torque left
_BEGUN = 3  # of which postures are drawn about
_DRAWN = 32  # about each
_SPREADS = (0.06, 0.015)  # of reach, from the first to the last
_STEP = 0.06  # [m] of room that is enough
_HOPELESS = 1.4  # times the torque limits, from which on nothing nearby is looked for

Clear = Callable[[Array, Posture], bool]  # points of links (N, P, 3) of a posture: may it be?


def refined(
    legs: Legs, tried: list[Posture], mu: float, most: float, clear: Clear
) -> tuple[list[Posture], float]:
    """Postures that hold with any one limb lifted, by exact kinematics; best first.

    And the least share of the torque limits that one needs, infinite without any.

    tried: with the share and shift of the first look; mu: friction that may be used; most: [m]
    that the body may shift; clear: of what stands about the robot.
    """
    own = _Search(legs, mu, most, clear)
    found = [own.looked(one, np.inf) for one in sorted(tried, key=lambda p: p.use)[:_LOOKED]]
    found.sort(key=_worth, reverse=True)
    rng = np.random.default_rng(0)
    begun = [one for one in found[:_BEGUN] if one.use < _HOPELESS]
    found += [own.moved(one, rng) for one in begun]
    least = min((one.use for one in found), default=np.inf)
    return sorted((one for one in found if one.use < 1), key=_worth, reverse=True), least


def _worth(posture: Posture) -> float:
    """What motors have left, but for room beyond what a step takes; what they lack, if anything."""
    return min(posture.room, _STEP) * (1 - posture.use) if posture.use < 1 else 1 - posture.use


class _Search:
    def __init__(self, legs: Legs, mu: float, most: float, clear: Clear) -> None:
        self.legs, self.mu, self.most, self.clear = legs, mu, most, clear
        sides = np.where(legs.outward[:, 0] == 0, 1.0, legs.outward[:, 0])
        self.normal = np.zeros((len(sides), 3))
        self.normal[:, 0] = -sides

    def looked(self, posture: Posture, enough: float) -> Posture:
        """A posture with its share by exact kinematics, cut short beyond `enough`."""
        legs = self.legs
        use, shift = moved_share(
            legs.chain, (legs.lower, legs.upper), posture.angles, posture.toes, self.normal,
            legs.torque, legs.weight, self.mu, self.most, enough,
        )  # fmt: skip
        return replace(posture, use=use, shift=shift, score=posture.room * (1 - use))

    def moved(self, posture: Posture, rng: np.random.Generator) -> Posture:
        """The best of postures drawn about one, and about what is found to be better."""
        for spread in np.geomspace(*_SPREADS, _DRAWN):
            drawn = self._drawn(posture, float(spread), rng)
            if drawn is None:
                continue
            # A share above this cannot be better, whatever the room
            worth = _worth(posture)
            enough = 1 - worth / min(drawn.room, _STEP) if worth > 0 else posture.use
            one = self.looked(drawn, enough) if enough > 0 else posture
            if _worth(one) > worth:
                posture = one
        return posture

    def _drawn(self, posture: Posture, spread: float, rng: np.random.Generator) -> Posture | None:
        """Toes near to those of a posture, if legs reach them, clear of all else."""
        legs, toes = self.legs, posture.toes.copy()
        half = 0.5 * posture.gap + spread * legs.reach.min() * rng.standard_normal()
        done: set[int] = set()
        for limb, other in enumerate(legs.mirror):
            if other in done:
                toes[limb, 1:] = toes[other, 1:]
                continue
            toes[limb, 1:] += spread * legs.reach[limb] * rng.standard_normal(2)
            done.add(limb)
        toes[:, 0] = -self.normal[:, 0] * half
        chain = replace(legs.chain, posture=posture.angles)
        found = chain.inverse(toes[None], legs.lower, legs.upper)
        if not found.valid.all():
            return None
        angles = found.best()
        quality = quality_of(chain, angles, np.zeros((len(toes), 3)), legs.limits)
        room = float(quality.room.min())
        one = replace(posture, angles=angles[0], toes=toes, room=room, gap=2 * half)
        if room < LEAST_ROOM or not clear_of_body(legs, quality.points).all():
            return None
        return one if self.clear(quality.points[0], one) else None
