"""A whole round of steps from one stance, by drawn body poses: more than postures one by one.

From a stance each limb in turn is lifted and set down a little further on, as a static gait does
it: the body goes, with every toe where it is, to a pose in which the others hold the robot, and in
which the limb reaches both its old place and its new one; the straight way there is looked at in
steps. Body poses are drawn about the last, nearer and nearer to the best. What is found is a round
that holds by statics of all links, within torque limits, friction, joint bounds and without parts
that touch; margins, springs and speeds are not asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.zoo.second.stances import Limbs, Stance, Surface, reached
from benchmarks.zoo.second.statics import least_load
from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.self_collision import SelfCollisionModel

_DRAWN = 60  # poses of the body for each limb that is lifted
_SPREADS = (0.3, 0.03)  # of a leg's length, and of 1 rad, from the first to the last
_TURNED = 0.3  # rad for each of these
_BETWEEN = 6  # places on the way from one pose to the next
_STEP = 0.02  # [m] that a toe moves on
_BEYOND = 1e-3  # [m] that joints may be inside surfaces


@dataclass(frozen=True)
class Walls:
    """What steps are made on."""

    surfaces: tuple[Surface, ...]  # of the limbs
    mu: float
    most: float  # share of the torque limits that may be used
    forward: Array  # (3,) unit: where toes go


@dataclass
class Way:
    """How a robot goes on with its toes on surfaces, by drawn poses of its body."""

    limbs: Limbs
    walls: Walls
    parts: SelfCollisionModel | None
    rng: np.random.Generator
    drawn: int = 0

    def share(self, stance: Stance, standing: tuple[int, ...]) -> float:
        """Of the torque limits that a stance needs; far beyond 1 without forces that hold it."""
        return least_load(self.limbs, self.walls.surfaces, stance, standing, self.walls.mu).rank

    def free(self, stance: Stance) -> bool:
        """Whether joints are on the robot's side of surfaces, and no parts touch."""
        limbs = self.limbs
        limbs.placed(stance.turn, stance.angles, stance.at)
        toes = [limbs.toe(limb)[0] for limb in range(len(limbs.names))]
        joints = np.array([limbs.data.oMi[k].translation for k in limbs.moving])
        for surface, toe in zip(self.walls.surfaces, toes, strict=True):
            level = toe[surface.axis] - surface.raised
            if (surface.side * (joints[:, surface.axis] - level)).max() > _BEYOND:
                return False
        return self.parts is None or not self.parts.find_collisions(stance.angles)

    def posed(self, stance: Stance, toes: Array, turn: Array, at: Array) -> Stance | None:
        """The stance with the body elsewhere and toes at points (N, 3)."""
        place = (float(at[0]), float(at[1]), float(at[2]))
        angles = reached(self.limbs, dict(enumerate(toes)), turn, place, stance.angles)
        return None if angles is None else replace(stance, turn=turn, at=place, angles=angles)

    def between(self, first: Stance, last: Stance, toes: Array) -> bool:
        """Whether the straight way of the body from one pose to another holds on all limbs."""
        pin = self.limbs.found.library
        turned = pin.log3(last.turn @ first.turn.T)
        start, end = np.array(first.at), np.array(last.at)
        every = tuple(range(len(toes)))
        for share in np.linspace(0, 1, _BETWEEN + 1):
            turn = pin.exp3(share * turned) @ first.turn
            one = self.posed(first, toes, turn, start + share * (end - start))
            if one is None or not self.free(one) or self.share(one, every) > self.walls.most:
                return False
            first = replace(first, angles=one.angles)
        return True

    def lifted(
        self, stance: Stance, toes: Array, limb: int, places: Array, there: Walls
    ) -> tuple[Stance, Array] | None:
        """The stance after a limb was lifted and set down at one of P places, and its toes.

        places: (P, 3) [m]; there: surfaces with the limb on that of its places. None where no pose
        was drawn from which the body does it.
        """
        limbs, pin = self.limbs, self.limbs.found.library
        others = tuple(i for i in range(len(toes)) if i != limb)
        best, least = stance, self.share(stance, others)
        for number, spread in enumerate(np.geomspace(*_SPREADS, _DRAWN)):
            if number:
                turn = pin.exp3(_TURNED * spread * self.rng.uniform(-1, 1, 3)) @ best.turn
                move = spread * float(limbs.lengths.min()) * self.rng.uniform(-1, 1, 3)
                self.drawn += 1
                one = self.posed(best, toes, turn, np.array(best.at) + move)
                if one is None:
                    continue
                share = self.share(one, others)
                if share >= least or not self.free(one):
                    continue
                best, least = one, share
            if least > self.walls.most:
                continue
            if (down := self._set_down(best, toes, limb, places, there)) is None:
                continue
            if self.between(stance, best, toes):
                return down
        return None

    def _set_down(
        self, stance: Stance, toes: Array, limb: int, places: Array, there: Walls
    ) -> tuple[Stance, Array] | None:
        for place in places:
            after = toes.copy()
            after[limb] = place
            down = self.posed(stance, after, stance.turn, np.array(stance.at))
            if down is not None and replace(self, walls=there).free(down):
                return down, after
        return None


def round_from(
    limbs: Limbs,
    walls: Walls,
    parts: SelfCollisionModel | None,
    stance: Stance,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], int]:
    """Limbs that could be lifted and set down further on one after another; poses drawn.

    All of them, where a whole round was found.
    """
    way = Way(limbs, walls, parts, rng)
    limbs.placed(stance.turn, stance.angles, stance.at)
    toes = np.array([limbs.toe(limb)[0] for limb in range(len(limbs.names))])
    every = tuple(range(len(toes)))
    if way.share(stance, every) > walls.most:
        return (), 0
    done: list[int] = []
    while len(done) < len(toes):
        left = [limb for limb in every if limb not in done]
        share = {i: way.share(stance, tuple(j for j in every if j != i)) for i in left}
        for limb in sorted(left, key=lambda i: share[i]):
            place = toes[limb] + _STEP * walls.forward
            found = way.lifted(stance, toes, limb, place[None], walls)
            if found is not None:
                stance, toes = found
                done.append(limb)
                break
        else:
            break
    return tuple(done), way.drawn
