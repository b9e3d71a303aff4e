"""From the ground to walls, by a second method: whether limbs can leave the ground one by one.

Whatever the order, before limb j goes to a wall some set of limbs S is there and the others stand
on the ground; while it is set down, all but j hold the robot. So sets are looked at from the last
step back: for each one that leads on to the walls postures are drawn with its limbs on walls and
the others on the ground, and a linear program asks of each of its limbs whether all others hold the
robot without it. Where no order is left that begins on the ground, none can be planned. Walls may
stand anywhere in each posture, so that more is allowed than one place asks for.

Where an order is left, the way itself is looked for, back from a stance between the walls, as
statics hold either way: limb by limb is taken off its wall and set down on the ground.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.zoo.second.stances import Limbs, Stance, Surface
from benchmarks.zoo.second.way import Walls, Way
from climbplan.arrays import Array

Limb = int
Held = dict[Limb, tuple[float, Stance]]  # by limb that is lifted: rank of the load, and its stance
Drawn = Callable[[tuple[Surface, ...], tuple[Limb, ...]], Held]
GROUND = Surface(2, -1.0)
_STANCES = 6  # between walls, from which a way is looked for
_SPOTS = 8  # on the ground, for each limb
_ABOUT = 0.4  # of a limb's length: how far these are from below its hip, and from below its toe
_LOW = (0.02, 0.1, 0.25)  # of the shortest limb's length, that the ground is below the lowest toe


@dataclass(frozen=True)
class Orders:
    """Which limbs may go to walls after one another."""

    order: tuple[Limb, ...]  # one that is left; empty where there is none
    lacks: str  # of the best there


def orders_to_walls(
    walls: tuple[Surface, ...], drawn: Drawn, most: float, lacking: Callable[[Held], str]
) -> Orders:
    """An order of limbs in which each could be held, looked for from the last to the first.

    drawn: the best stance for each limb, by surfaces and limbs that are lifted; most: share of the
    torque limits that may be used; lacking: what the best of stances lacks.
    """
    every = frozenset(range(len(walls)))
    open_sets: list[tuple[frozenset[Limb], tuple[Limb, ...]]] = [(every, ())]
    known = {every}
    most_down, lacks = 0, ""
    while open_sets:
        on_walls, after = open_sets.pop()
        surfaces = tuple(walls[i] if i in on_walls else GROUND for i in range(len(walls)))
        held = drawn(surfaces, tuple(sorted(on_walls)))
        good = sorted((load, limb) for limb, (load, _) in held.items() if load <= most)
        if not good and (not lacks or len(after) >= most_down):
            most_down, lacks = len(after), lacking(held)
        for _, limb in reversed(good):
            before = on_walls - {limb}
            if not before:
                return Orders((limb, *after), "")
            if before not in known:
                known.add(before)
                open_sets.append((before, (limb, *after)))
    return Orders((), lacks)


def way_to_ground(
    limbs: Limbs,
    way: Way,
    stances: list[Stance],
    order: tuple[Limb, ...],
    rng: np.random.Generator,
) -> int:
    """How many limbs could be taken from walls to the ground, at most; all where a way is found.

    order: in which they went to the walls.
    """
    walls, most = way.walls, 0
    for stance in stances[:_STANCES]:
        for low in _LOW:
            way.walls = walls
            limbs.placed(stance.turn, stance.angles, stance.at)
            toes = np.array([limbs.toe(limb)[0] for limb in range(len(limbs.names))])
            level = float(toes[:, 2].min()) - low * float(limbs.lengths.min())
            most = max(most, _down(limbs, way, stance, toes, order, level, rng))
            if most == len(order):
                way.walls = walls
                return most
    way.walls = walls
    return most


def _down(
    limbs: Limbs,
    way: Way,
    stance: Stance,
    toes: Array,
    order: tuple[Limb, ...],
    level: float,
    rng: np.random.Generator,
) -> int:
    """Limbs that got to a ground at a height [m], last of the order first, others where not."""
    every = tuple(range(len(toes)))
    if way.share(stance, every) > way.walls.most:
        return 0
    left = list(reversed(order))
    while left:
        for limb in left:
            spots = _spots(limbs, stance, toes, limb, level, rng)
            on_ground = _on_ground(way.walls, limb)
            found = way.lifted(stance, toes, limb, spots, on_ground)
            if found is not None:
                stance, toes = found
                way.walls = on_ground
                left.remove(limb)
                break
        else:
            break
    return len(order) - len(left)


def _on_ground(walls: Walls, limb: Limb) -> Walls:
    own = list(walls.surfaces)
    own[limb] = GROUND
    return replace(walls, surfaces=tuple(own))


def _spots(
    limbs: Limbs, stance: Stance, toes: Array, limb: Limb, level: float, rng: np.random.Generator
) -> Array:
    """(S, 3) places on the ground for a limb: about below its hip, and towards where its toe is."""
    limbs.placed(stance.turn, stance.angles, stance.at)
    first = limbs.model.getJointId(limbs.joints[limb][0].name)
    hip = np.array(limbs.data.oMi[first].translation)
    share = rng.uniform(0.0, 0.9, (_SPOTS, 1))
    spots = (1 - share) * hip + share * toes[limb]
    spots[:, :2] += rng.uniform(-_ABOUT, _ABOUT, (_SPOTS, 2)) * limbs.lengths[limb] / 2
    inside = np.abs(toes[:, 0]).max() - 0.02
    spots[:, 0] = np.clip(spots[:, 0], -inside, inside)
    spots[:, 2] = level
    return spots
