"""Swing paths: how a toe moves clear of the terrain from one contact to the next.

The straight way between two hover points is tried first, then ways over one point aside and ways
drawn aside as a whole, nearest first. A way counts if the toe keeps its clearance, the limb reaches
every point of it within its joint bounds, and its links, as thick as they are, miss the obstacles
from lifting off to setting down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.clearance.limb_pairs import SelfShortfall, compute_self_shortfall
from climbplan.climb.clearance.limbs import BETWEEN, LimbShortfall, find_closest_link
from climbplan.climb.clearance.raw_surface import (
    THE_SCAN,
    Contacts,
    find_nearest_raw,
    raw_toes_clear,
)
from climbplan.climb.clearance.swing_ways import candidates, hover, joined, sampled, sampled_shares
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, Unresolved
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.foot import Sole
from climbplan.robots.kinematics import standing_inverse
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.solids import Solid

_OVERLAP = 1e-9  # [m] that counts
TOE_CLEARANCE = 0.01  # [m] distance a swinging toe, or the foot round it, keeps from every solid
_TOUCHES = 1e-6  # [m] by which a foot that stands may seem to be in what it stands on
# [m] what it keeps from a scan where some way does: over a long walk the body is 10 to 15 mm lower
# than planned, and a toe that catches an edge drags the feet that stand
_ROOMY = 0.03
_OF_LIFT = 0.5  # share of the lift that this is at most


@dataclass(frozen=True)
class Swing:
    """One limb's move: the body stands still while the toe goes from old to new."""

    limb: int
    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]
    old: Array  # (3,) contact left [m]
    new: Array  # (3,) contact reached [m]
    normals: Array  # (2, 3) unit normals at old and new
    where: str  # "round 3, LM lifted"
    toes: Array | None = None  # (N, 3) of all limbs as it begins [m]
    still: BoolArray | None = None  # (N,) limbs that stand meanwhile
    under: Array | None = None  # (N, 3) normals of the surfaces under them all

    @property
    def contacts(self) -> Array:
        """(2, 3) the old and the new one [m]."""
        return np.stack([self.old, self.new])

    def turned(self, way: Array) -> Array:
        """(S, 3) normals that a sole turns with along a way (P, 3), where it is `sampled`."""
        share = sampled_shares(way)[:, None]
        return np.asarray((1 - share) * self.normals[0] + share * self.normals[1])


WAYS = "some ways of a limb are looked at, between postures that the planner chose"


class SwingBlocked(Unresolved):
    """No way was found on which a limb misses the obstacles; says what is missing at least."""

    def __init__(self, shortfall: LimbShortfall, words: str) -> None:
        self.shortfall = shortfall
        conflict = Conflict(shortfall.where, (words,), in_words=True)
        super().__init__("no clear swing path", [conflict], because=WAYS, stage="swing")


class SwingMeets(Unresolved):
    """On all ways of a limb that are clear of the terrain it meets another one, or the body."""

    def __init__(self, limb: int, where: str, words: str) -> None:
        self.limb = limb
        conflict = Conflict(where, (words,), in_words=True)
        super().__init__("no clear swing path", [conflict], because=WAYS, stage="swing")


def swings_of(scene: MotionScene, rounds: Rounds, instants: Instants) -> tuple[Swing, ...]:
    """All limb moves of a posture sequence in their order, limbs that move at once by number."""
    names, toes, found = scene.robot.limb_names, rounds.toes[0], []
    for k in range(0, instants.count, 2):
        new = instants.toes[k + 1]
        pose = instants.com[k], instants.rpy[k]
        where = instants.label(k, names)
        for limb in (int(i) for i in np.flatnonzero(instants.lifted[k])):
            normals = instants.normal[[k, k + 1], limb]
            still = ~instants.lifted[k]
            under = instants.normal[k]
            found.append(
                Swing(limb, *pose, toes[limb], new[limb], normals, where, toes, still, under)
            )
        toes = new
    return tuple(found)


def plan_swing_paths(scene: MotionScene, rounds: Rounds, instants: Instants) -> tuple[Array, ...]:
    """Way points of all limb moves of a posture sequence.

    Raises as `swing_path`; of several swings that links block, for the one that misses most.
    """
    paths: list[Array] = []
    worst: SwingBlocked | None = None
    for swing in swings_of(scene, rounds, instants):
        try:
            paths.append(swing_path(scene, swing))
        except SwingBlocked as blocked:
            if worst is None or blocked.shortfall.missing > worst.shortfall.missing:
                worst = blocked
    if worst is not None:
        raise worst
    return tuple(paths)


def swing_path(scene: MotionScene, swing: Swing) -> Array:
    """Way points (P, 3) from above the old contact to above the new one [m].

    Raises SwingBlocked where the limb's links cannot miss the obstacles, and NotProved naming
    what blocks the toe.
    """
    solids = scene.terrain.solids
    lift = scene.spec.trajectory.swing_clearance
    ends = hover(swing.contacts, swing.normals, lift)
    robot = scene.robot.one_limb(swing.limb)
    blocker: str | None = None
    # Lifting off and setting down are parts of every way
    legs = [sampled(np.stack(leg)) for leg in zip(swing.contacts, ends, strict=True)]
    normals = [np.broadcast_to(n, leg.shape) for n, leg in zip(swing.normals, legs, strict=True)]
    closest = _links_too_near(
        scene, swing, _links(robot, swing, np.concatenate(legs), np.concatenate(normals))
    )
    if closest is not None:
        raise SwingBlocked(closest, f"{closest.words(scene)} as its toe is lifted or set down")
    size = 0.0 if robot.foot is None else robot.foot.radius
    if size:
        for way in legs:
            near = _too_near(way, solids, size - _TOUCHES)
            if near is not None:
                blocker = f"to where its foot of {1e3 * size:.0f} mm clears {near.name!r}"
                raise _no_way(swing, blocker)
    if robot.sole is not None:
        for way, under in zip(legs, normals, strict=True):
            near = _too_near(_under_sole(robot.sole, way, under), solids, -_TOUCHES)
            if near is not None:
                raise _no_way(swing, f"to where its sole clears {near.name!r}")
    beside = _Beside.of(scene.robot, swing)
    tried, met = 0, None
    for path in _roomiest_first(scene, candidates(swing.contacts, swing.normals, lift)):
        whole = path if np.array_equal(path[[0, -1]], ends) else joined(ends, path)
        way = swing.turned(whole)
        looked_at = sampled(path)
        if robot.sole is not None:
            looked_at = _under_sole(robot.sole, sampled(whole), way)
        near = _too_near(looked_at, solids, TOE_CLEARANCE + size)
        if near is not None:
            blocker = blocker or near.name
            continue
        if scene.terrain.scan is not None and not raw_toes_clear(
            scene.terrain.scan, sampled(path), TOE_CLEARANCE + size
        ):
            blocker = blocker or THE_SCAN
            continue
        links = _links(robot, swing, sampled(whole), way)
        if links is None:
            continue
        found = _links_too_near(scene, swing, links)
        if found is None:
            overlap = None if beside is None else beside.overlap(links)
            if overlap is None:
                return whole
            met = met or overlap
            continue
        tried += 1
        if closest is None or found.missing < closest.missing:
            closest = found
    if closest is not None:
        raise SwingBlocked(closest, f"{closest.words(scene)} on the clearest of {tried} ways")
    if met is not None:
        words = f"{met.describe(scene.robot)} on the nearest way"
        raise SwingMeets(swing.limb, swing.where, words)
    raise _no_way(swing, f"past {blocker!r}" if blocker is not None else "within the limb's reach")


def _no_way(swing: Swing, where: str) -> Unresolved:
    conflict = Conflict(swing.where, (f"swing path of the toe {where}",))
    return Unresolved("no clear swing path", [conflict], because=WAYS, stage="swing")


@dataclass(frozen=True)
class _Beside:
    """A robot that stands, all but one limb, which swings."""

    robot: Robot
    swing: Swing
    still: BoolArray  # (N,)
    standing: Capsules  # (1, N, C), world; NaN of limbs out of reach

    @classmethod
    def of(cls, robot: Robot, swing: Swing) -> _Beside | None:
        """None where the swing does not say where the others stand."""
        if swing.toes is None or swing.still is None:
            return None
        pose = swing.com[None], swing.rpy[None]
        under = np.zeros_like(swing.toes) if swing.under is None else swing.under
        angles = standing_inverse(robot, *pose, swing.toes[None], under[None]).best()
        standing = limb_capsules(robot, angles).to_world(swing.com, rotation_world_body(swing.rpy))
        return cls(robot, swing, swing.still, standing)

    def overlap(self, links: Capsules) -> SelfShortfall | None:
        """Where the limb meets another one or the body on its way (S, 1, C), if it does."""
        swing, count = self.swing, len(links.starts)
        turn = rotation_world_body(swing.rpy)

        def seen(standing: Array, moving: Array) -> Array:
            every = np.repeat(standing, count, axis=0)
            every[:, swing.limb] = moving[:, 0]
            return np.asarray((every - swing.com) @ turn)  # in the body frame

        starts = seen(self.standing.starts, links.starts)
        ends = seen(self.standing.ends, links.ends)
        every = replace(self.standing, starts=starts, ends=ends)
        worst = compute_self_shortfall(self.robot, every, swing.limb, self.still)
        return worst if worst.missing > _OVERLAP else None


def _links_too_near(
    scene: MotionScene, swing: Swing, links: Capsules | None
) -> LimbShortfall | None:
    """The link that comes closest to an obstacle, if that is closer than links may come."""
    if links is None:
        return None
    if scene.terrain.scan is not None:
        contacts = Contacts(np.stack([swing.old, swing.new]), swing.normals)
        raw = find_nearest_raw(scene.terrain.scan, links, contacts, BETWEEN)
        if raw.missing > 1e-9:
            return LimbShortfall(
                raw.missing, swing.where, swing.limb, raw.link, raw.radius, THE_SCAN, raw.solids
            )
    solids = scene.terrain.link_solids
    if not solids:
        return None
    found = find_closest_link(scene, links, swing.limb)
    if found.distance >= BETWEEN - 1e-9:
        return None
    solid = solids[found.solid]
    return LimbShortfall(
        BETWEEN - found.distance,
        swing.where,
        swing.limb,
        found.link,
        found.radius,
        solid.name,
        (solid,) if isinstance(solid, Solid) else (),
    )


def _roomiest_first(scene: MotionScene, paths: Iterator[Array]) -> Iterator[Array]:
    """Ways on which the toe has room to spare beside a scan, then all others, each in its order."""
    scan = scene.terrain.scan
    size = 0.0 if scene.robot.foot is None else scene.robot.foot.radius
    room = min(_ROOMY, _OF_LIFT * scene.spec.trajectory.swing_clearance)
    if scan is None or room <= TOE_CLEARANCE:
        yield from paths
        return
    others = []
    for path in paths:
        if raw_toes_clear(scan, sampled(path), room + size):
            yield path
        else:
            others.append(path)
    yield from others


def _too_near(points: Array, solids: tuple[Solid, ...], least: float) -> Solid | None:
    """The solid that toes at points (S, 3) come closer to than `least` [m], if any.

    The face distance never exceeds the true distance, so what passes here is really clear.
    """
    for solid in solids:
        if solid.face_distance(points).min() < least - 1e-9:
            return solid
    return None


def _under_sole(sole: Sole, toes: Array, normals: Array) -> Array:
    """Corners and middles (P, 3) of soles about toes (S, 3), turned with normals (S, 3)."""
    unit = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.concatenate([toes, (toes[:, None] + sole.arms(unit)).reshape(-1, 3)])


def _links(robot: Robot, swing: Swing, toes: Array, normals: Array) -> Capsules | None:
    """Links (S, 1, C) of the limb along a way, or None if a point is out of reach.

    normals: (S, 3) that soles turn with.
    """
    pose = np.broadcast_to(swing.com, toes.shape), np.broadcast_to(swing.rpy, toes.shape)
    solution = standing_inverse(robot, *pose, toes[:, None], normals[:, None])
    if not solution.valid.all():
        return None
    links = limb_capsules(robot, solution.best())
    return links.to_world(swing.com, rotation_world_body(swing.rpy))
