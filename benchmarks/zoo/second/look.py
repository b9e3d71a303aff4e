"""Whether a refusal of `zoo` stands up to drawn postures and statics of all links.

What every plan of a column has to have is looked for: for each limb a posture in which the others
hold the robot while it is lifted (`wall`: for one limb). Postures are drawn anywhere first, then
about the best that was found. A limb without such a posture makes the refusal right as far as
drawing can tell; how near the best comes is told in N m or mm. Where every limb has one, a whole
round of steps is looked for from the stances that come nearest (`way.py`). Walks have to have room
for their toes (`room.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.zoo.second.room import roomiest
from benchmarks.zoo.second.stances import Limbs, Stance, Surface, anywhere, beside, onto
from benchmarks.zoo.second.statics import Load, least_load
from benchmarks.zoo.second.subject import Subject
from benchmarks.zoo.second.to_walls import Held, orders_to_walls, way_to_ground
from benchmarks.zoo.second.way import Walls, Way, round_from
from climbplan.robots.urdf.proposal.bracing_grid_search import FRICTION_SAFETY, WALL_FRICTIONS
from climbplan.robots.urdf.proposal.prepared_robot import FLOOR_FRICTION
from climbplan.robots.urdf.proposal.self_collision import SelfCollisionModel

COUNT = 150  # postures drawn anywhere that have their toes on surfaces, and are free of all else
_MOST = 20  # times as many that are drawn for them
_ENOUGH = 1 / 1.2  # of the torque limits, as the specs ask for S_tau of 1.2
_NEARER = 2 / 3  # as many again about the best, for each limb
_SPREADS = (0.5, 0.05)  # [rad] about it, from the first to the last
_STAIR = 0.05  # [m]: what the zoo's are at least
_ROUNDS = 8  # stances from which a round of steps is looked for
CLIMBS = ("ground", "stairs", "chimney", "wall")


@dataclass(frozen=True)
class Look:
    """What the second method says."""

    verdict: str  # "refusal right", "not borne out", "not decided", "limit of ours"
    words: str
    reached: int = 0  # postures with every toe on its surface and all else clear
    drawn: int = 0


def second_look(subject: Subject, column: str, seed: int, count: int = COUNT) -> Look:
    """Look again at a refused column of a robot that something was proposed for."""
    limbs = subject.limbs
    if column not in CLIMBS:
        surfaces = (Surface(2, -1.0),) * len(limbs.names)
        room = roomiest(subject, surfaces, seed, count)
        return Look(room.verdict, room.words, room.reached, room.drawn)
    surfaces, mu = surfaces_of(limbs, subject.on_walls, column)
    if column == "wall":
        return _from_ground(subject, surfaces, mu, seed, count)
    return looked(limbs, surfaces, mu, seed, count, subject.parts, subject.attitudes)


def limit_of_walks(words: str) -> Look | None:
    """A walk that is refused for what climbplan does not know, whatever the robot can."""
    kind = words.partition("walking is of ")[2]
    if not words.startswith("no spec: ") or not kind:
        return None
    return Look("limit of ours", f"walks are of {kind}")


def surfaces_of(
    limbs: Limbs, on_walls: tuple[bool, ...], column: str
) -> tuple[tuple[Surface, ...], float]:
    """Where each limb's toe has to be, and the friction that may be used."""
    sides = np.where(limbs.hips[:, 0] < 0, -1.0, 1.0)
    if column in ("chimney", "wall"):
        return tuple(Surface(0, float(side)) for side in sides), max(
            WALL_FRICTIONS
        ) / FRICTION_SAFETY
    raised = np.zeros(len(sides))
    if column == "stairs":  # the front half is one stair up
        raised = np.where(limbs.hips[:, 1] > np.median(limbs.hips[:, 1]), _STAIR, 0.0)
    surfaces = tuple(
        Surface(0, float(side)) if wall else Surface(2, -1.0, float(up))
        for side, wall, up in zip(sides, on_walls, raised, strict=True)
    )
    return surfaces, FLOOR_FRICTION / FRICTION_SAFETY


class _Drawn:
    """Postures so far: the best for each limb that is lifted, and stances good for all of them."""

    def __init__(
        self,
        limbs: Limbs,
        surfaces: tuple[Surface, ...],
        mu: float,
        parts: SelfCollisionModel | None,
    ) -> None:
        self.limbs, self.surfaces, self.mu, self.parts = limbs, surfaces, mu, parts
        self.best: list[tuple[Load, Stance] | None] = [None] * len(limbs.names)
        self.whole: list[tuple[float, Stance]] = []  # by the mean rank of loads
        self.reached = self.total = 0
        self.near, self.out = np.inf, np.inf

    @property
    def misses(self) -> str:
        """Why no posture is on all surfaces and clear of all else."""
        if self.out == 0:
            return "parts of the robot touch in every posture that was drawn"
        if np.isfinite(self.out):
            return f"joints are {1e3 * self.out:.0f} mm or more beyond surfaces"
        return f"toes miss their surfaces by {1e3 * self.near:.0f} mm or more"

    def add(self, stance: Stance, about: int | None = None) -> None:
        """Judge a stance; about: the limb for whose sake it was drawn, None for all."""
        self.total += 1
        self.near = min(self.near, stance.missed)
        if stance.missed > 0:
            return
        self.out = min(self.out, stance.beyond)
        if stance.beyond > 0 or (self.parts and self.parts.find_collisions(stance.angles)):
            return
        self.reached += 1
        number = len(self.best)
        shares = []
        for lifted in range(number) if about is None else (about,):
            others = tuple(limb for limb in range(number) if limb != lifted)
            load = least_load(self.limbs, self.surfaces, stance, others, self.mu)
            shares.append(load.rank)
            known = self.best[lifted]
            if known is None or load.rank < known[0].rank:
                self.best[lifted] = load, stance
        if about is None:
            self.whole = sorted([*self.whole, (float(np.mean(shares)), stance)], key=_share)
            del self.whole[_ROUNDS:]


def _share(one: tuple[float, Stance]) -> float:
    return one[0]


def looked(
    limbs: Limbs,
    surfaces: tuple[Surface, ...],
    mu: float,
    seed: int,
    count: int = COUNT,
    parts: SelfCollisionModel | None = None,
    attitudes: int = 1,
) -> Look:
    """Draw postures, and tell what they say of a refusal.

    parts: that must not touch. attitudes: in which the body is drawn.
    """
    rng = np.random.default_rng(seed)
    drawn = _Drawn(limbs, surfaces, mu, parts)
    _draw(drawn, tuple(range(len(limbs.names))), rng, count, attitudes)
    if not drawn.reached:
        return Look("not decided", drawn.misses, 0, drawn.total)
    refused = _lacking(drawn)
    if refused:
        return Look("refusal right", refused, drawn.reached, drawn.total)
    return _with_way(drawn, rng)


def _draw(
    drawn: _Drawn,
    lifted: tuple[int, ...],
    rng: np.random.Generator,
    count: int,
    attitudes: int,
) -> None:
    """Postures anywhere, about the best, and about the best for each limb that is lifted."""
    limbs, surfaces = drawn.limbs, drawn.surfaces
    while drawn.reached < count and drawn.total < _MOST * count:
        drawn.add(onto(limbs, surfaces, *anywhere(limbs, rng, attitudes)))
    more = int(_NEARER * count)
    for spread in np.geomspace(*_SPREADS, more) if drawn.whole else ():
        drawn.add(onto(limbs, surfaces, *beside(limbs, drawn.whole[0][1], spread, rng)))
    for limb in lifted:
        for spread in np.geomspace(*_SPREADS, more):
            known = drawn.best[limb]
            if known is None or known[0].share <= _ENOUGH:
                break
            drawn.add(onto(limbs, surfaces, *beside(limbs, known[1], spread, rng)), limb)


def _from_ground(
    subject: Subject, walls: tuple[Surface, ...], mu: float, seed: int, count: int
) -> Look:
    """From the ground to walls: orders of limbs, and a way by one of them."""
    limbs, rng = subject.limbs, np.random.default_rng(seed)
    sets: list[_Drawn] = []

    def at(surfaces: tuple[Surface, ...], lifted: tuple[int, ...]) -> _Drawn:
        one = _Drawn(limbs, surfaces, mu, subject.parts)
        _draw(one, lifted, rng, count, subject.attitudes)
        sets.append(one)
        return one

    def held(surfaces: tuple[Surface, ...], lifted: tuple[int, ...]) -> Held:
        best = {i: at_once for i, at_once in enumerate(at(surfaces, lifted).best) if at_once}
        return {i: (best[i][0].rank, best[i][1]) for i in lifted if i in best}

    orders = orders_to_walls(walls, held, _ENOUGH, lambda _: _lacks_of(sets[-1]))
    reached, total = sum(one.reached for one in sets), sum(one.total for one in sets)
    if not all(one.reached for one in sets):
        misses = next(one.misses for one in sets if not one.reached)
        if not orders.order:
            return Look("not decided", misses, reached, total)
    if not orders.order:
        words = f"in no order do limbs leave the ground: {orders.lacks}"
        return Look("refusal right", words, reached, total)
    way = Way(limbs, Walls(walls, mu, _ENOUGH, np.zeros(3)), subject.parts, rng)
    last = sets[0].best[orders.order[-1]]
    stances = [] if last is None else [last[1]]
    stances += [stance for _, stance in sets[0].whole]
    gone = way_to_ground(limbs, way, stances, orders.order, rng)
    total += way.drawn
    names = ", ".join(limbs.names[i] for i in orders.order)
    if gone == len(limbs.names):
        words = "a way from walls to the ground, and so back, was found"
        return Look("not borne out", words, reached, total)
    words = (
        f"limbs may leave the ground in the order {names} by postures one by one; of a way at most "
        f"the last {gone} were found"
    )
    return Look("not decided", words, reached, total)


def _lacks_of(drawn: _Drawn) -> str:
    """What the best limb to lift of some lacks."""
    ranks = [(one[0].rank, i) for i, one in enumerate(drawn.best) if one is not None]
    on = [i for i, s in enumerate(drawn.surfaces) if s.axis == 0]
    ranks = [one for one in ranks if one[1] in on]
    if not ranks:
        return drawn.misses
    ground = [drawn.limbs.names[i] for i, s in enumerate(drawn.surfaces) if s.axis != 0]
    there = f"with {', '.join(ground)} on the ground and the others on walls, " if ground else ""
    return f"{there}{_lack(drawn, min(ranks)[1])}"


def _lacking(drawn: _Drawn) -> str:
    """What the best postures lack; empty where they hold."""
    ranks = [one[0].rank for one in drawn.best if one is not None]
    limb = int(np.argmax(ranks))
    return "" if ranks[limb] <= _ENOUGH else _lack(drawn, limb)


def _lack(drawn: _Drawn, limb: int) -> str:
    """What the best posture with a limb lifted lacks."""
    known = drawn.best[limb]
    assert known is not None
    load, name = known[0], drawn.limbs.names[limb]
    if np.isinf(load.share):
        return (
            f"with {name} lifted no forces within friction hold it, {load.added:.0%} of the weight "
            "short (moments over 1 m)"
        )
    has = _ENOUGH * load.limit
    return (
        f"with {name} lifted {load.joint} needs {load.torque:.3g} N m at the least that was found, "
        f"{load.torque - has:.2g} N m more than the {has:.3g} N m that may be used"
    )


def _with_way(drawn: _Drawn, rng: np.random.Generator) -> Look:
    """Postures hold: whether steps lead from one to another."""
    use = max(one[0].share for one in drawn.best if one is not None)
    postures = f"postures hold with {use:.0%} of the torque limits"
    walls = drawn.surfaces[0].axis == 0 and all(s.axis == 0 for s in drawn.surfaces)
    forward = np.array([0.0, 0.0, 1.0]) if walls else np.array([0.0, 1.0, 0.0])
    asked = Walls(drawn.surfaces, drawn.mu, _ENOUGH, forward)
    number, most = len(drawn.best), 0
    total = drawn.total
    for _, stance in drawn.whole:
        done, poses = round_from(drawn.limbs, asked, drawn.parts, stance, rng)
        total += poses
        most = max(most, len(done))
        if most == number:
            words = f"{postures}, and a round of {number} steps from one of them was found"
            return Look("not borne out", words, drawn.reached, total)
    words = (
        f"{postures}, one by one; from {len(drawn.whole)} stances at most {most} of {number} limbs "
        "stepped on one after another"
    )
    return Look("not decided", words, drawn.reached, total)
