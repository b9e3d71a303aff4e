"""Deliveries in several legs: the box is put down on the way, and taken up by other arms.

A search over where the box stands: states are places on the ground, an action carries or throws it
from one place to the next by arms from certain anchors. Arms hold the box at places where the
closed inverse has an answer within joint ranges that touches nothing solid; the fewest legs that
lead to the goal order the search and are what no relay over the same places goes below.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray

from climbplan.limms.arms.held_branches import (
    APPROACH_MARGIN,
    RANGE_MARGIN,
    clearance,
    off_singular,
)
from climbplan.limms.bounds import (
    Connection,
    access,
    anchor_wrist,
    chain_stretch,
    holding_misfit,
    side_wrist,
    span,
    within_reach,
)
from climbplan.limms.corridor import centre_blocks, way_length, yaws_between
from climbplan.limms.modules.chain import BRANCHES, in_range
from climbplan.limms.modules.limbs import arm, limb_angles, root_on_anchor
from climbplan.limms.placement import extents
from climbplan.limms.scene import SIDES, Array, Index, Scene
from climbplan.limms.sequences import FLIGHT

STEP = 0.12  # [m] between places
MOST = 10  # relays that are listed
ALIKE = 2  # of them, with the same arms one after the other
CHEAPEST = 1.4  # cost of the cheapest relay, as `Sequence.cost` counts
_NEXT = 3  # places that are gone on from, of each state and set of arms
_APART = 0.002  # [m] of arms from what is solid
_SWITCH = 0.3  # cost of other anchors than in the leg before
_THROW = 0.5  # of a throw in place of a carried leg

Mask = NDArray[np.bool_]
Place = tuple[float, ...]  # (D,) of the box [m, rad]


@dataclass(frozen=True)
class Leg:
    """The box from one place to the next, by arms."""

    connections: tuple[Connection, ...]
    begin: Place
    end: Place
    is_thrown: bool = False


@dataclass(frozen=True)
class Relay:
    """Legs one after the other; the box stands between them."""

    legs: tuple[Leg, ...]

    def cost(self) -> float:
        """What is tried first, as `Sequence.cost` counts: a second leg is less than a module."""
        most = max(len(leg.connections) for leg in self.legs)
        thrown = _THROW * any(leg.is_thrown for leg in self.legs)
        return most + (CHEAPEST - 1) * (len(self.legs) - 1) + thrown

    def named(self, scene: Scene) -> str:
        """In words."""
        names = scene.anchor_names[scene.wall_offset :]
        parts = []
        for leg in self.legs:
            arms = ", ".join(f"{names[c.root]} to {SIDES[c.side]}" for c in leg.connections)
            parts.append(f"{'throw' if leg.is_thrown else 'arms'}: {arms}")
        return "relay: " + ", then ".join(parts)


def relays(scene: Scene, fewest: int = 2) -> Iterator[Relay]:
    """Relays of `fewest` legs and more, those of the fewest legs and least ways first."""
    places = np.vstack([scene.start_place, scene.goal_place, standing_spots(scene)])
    sets = [(arms, mask) for arms, mask in _holding(scene, places) if mask.any()]
    thrown = _thrown(scene, sets)
    left = _legs_left(sets, thrown, len(places))
    if left[0] < fewest or left[0] >= len(places):
        return
    number = count()
    queue: list[tuple[float, int, int, int, tuple[Leg, ...]]] = [(0.0, next(number), 0, -1, ())]
    listed: dict[tuple[tuple[Connection, ...], ...], int] = {}
    visits = np.zeros((len(places), len(sets) + 1), int)
    while queue and sum(listed.values()) < MOST:
        cost, _, here, before, legs = heapq.heappop(queue)
        if here == 1:
            arms_in_turn = tuple(leg.connections for leg in legs)
            if listed.get(arms_in_turn, 0) < ALIKE:
                listed[arms_in_turn] = listed.get(arms_in_turn, 0) + 1
                yield Relay(legs)
            continue
        visits[here, before] += 1
        if visits[here, before] > 1 or visits[here].sum() > MOST:
            continue
        for k, (arms, mask) in enumerate(sets):
            if not mask[:, here].any():
                continue
            other = 0.0 if before >= 0 and _same(arms, sets[before][0]) else _SWITCH
            for there, is_thrown in _onward(mask, here, left, thrown[k], places):
                way = float(way_length(places[here], places[there]))
                leg = Leg(arms, _tuple(places[here]), _tuple(places[there]), is_thrown)
                extra = 0.1 * len(arms) + 0.2 * way + other + _THROW * is_thrown
                entry = (cost + 1.0 + extra, next(number), there, k, (*legs, leg))
                heapq.heappush(queue, entry)


def places_aside(scene: Scene, later: Scene) -> tuple[Array, Index, Index]:
    """Standing places (n, D) and the fewest legs (n,) that lead there, and on to the goal later.

    later: the scene as it may be then. Legs are carried; `n + 2` where none lead.
    """
    places = np.vstack([scene.start_place, scene.goal_place, standing_spots(scene)])
    there, onward = (
        _carried_legs([(arms, mask) for arms, mask in _holding(seen, places)], to, len(places))
        for seen, to in ((scene, 0), (later, 1))
    )
    return places[2:], there[2:], onward[2:]


def standing_spots(scene: Scene) -> Array:
    """Placements of the box (n, D) on a grid, its whole base on the ground [m, rad]."""
    blocks = centre_blocks(scene)
    turned = [
        _standing_at(scene, blocks, float(yaw) if scene.turns else None)
        for yaw in yaws_between(scene)
    ]
    return np.concatenate(turned)


def _standing_at(scene: Scene, blocks: Array, yaw: float | None) -> Array:
    """The same of one yaw, of which nothing is said where the box does not turn."""
    half = extents(scene.box_size[0] / 2, yaw or 0.0, yaw or 0.0)
    found: set[Place] = set()
    for patch in scene.patches:
        spans = [
            np.arange(np.ceil((low + h) / STEP), np.floor((high - h) / STEP) + 1) * STEP
            for low, high, h in zip(patch.lower, patch.upper, half[:2], strict=True)
        ]
        for x in spans[0]:
            height = patch.height + half[2]
            found |= {(float(x), float(y), float(height)) for y in spans[1]}
    spots = np.array(sorted(found)).reshape(-1, 3)
    if yaw is not None:
        spots = np.column_stack([spots, np.full(len(spots), yaw)])
    above = spots[:, None] >= blocks[:, 0] - 1e-9
    inside = (above & (spots[:, None] <= blocks[:, 1] + 1e-9)).all(axis=2)
    away = np.abs(spots[:, None, :2] - scene.stand[None, :, :2])
    apart = np.any(away > half[:2] + scene.module.radius, axis=2)
    unoccupied = np.all(apart | np.any(np.isnan(scene.stand), axis=1), axis=1)
    kept: Array = spots[np.any(inside, axis=1) & unoccupied]
    return kept


def _holding(scene: Scene, places: Array) -> list[tuple[tuple[Connection, ...], Mask]]:
    """Sets of arms that hold the box, and where they can, (branches, places).

    Single arms where one latch holds the box, else pairs.
    """
    single: list[tuple[Connection, Mask]] = []
    for root in range(scene.walls):
        if access(scene, root):
            single += [
                (Connection(root, side), _held_at(scene, Connection(root, side), places))
                for side in range(4)
            ]
    alone: list[tuple[tuple[Connection, ...], Mask]] = [
        ((connection,), mask)
        for connection, mask in single
        if not holding_misfit(scene, (connection,))
    ]
    if alone or scene.count < 2:
        return alone
    return [
        ((one, other), np.atleast_2d(a.any(axis=0) & b.any(axis=0)))
        for (one, a), (other, b) in combinations(single, 2)
        if one.root != other.root
        and one.side != other.side
        and not holding_misfit(scene, (one, other))
    ]


def _held_at(scene: Scene, connection: Connection, places: Array) -> Mask:
    """Where an arm can hold the box (branches, n), its last end on the anchor."""
    latched = bool(scene.held.size and (scene.held == scene.wall_offset + connection.root).any())
    box_end = 1 if latched else 0
    limb = arm(0, connection.side, root_on_anchor(scene, connection.root, 1 - box_end), box_end)
    # Where latches close programs keep further from the ends of ranges; at the goal none closes
    margin = np.full(len(places), RANGE_MARGIN + APPROACH_MARGIN)
    margin[1] = RANGE_MARGIN
    near = np.array([within_reach(scene, (connection,), place) for place in places])
    found = np.zeros((len(BRANCHES), len(places)), bool)
    if not near.any():
        return found
    box = places[near]
    feet = np.broadcast_to(limb.fixed_position, (len(box), 3))
    for number, branch in enumerate(BRANCHES):
        angles, missing = limb_angles(scene, limb, box, feet, branch)
        angles = (angles + np.pi) % (2 * np.pi) - np.pi
        fits = (missing <= 0) & (in_range(scene.module, angles) <= -margin[near])
        fits &= off_singular(scene.module, angles)
        if fits.any():
            gap = clearance(scene, [limb], box[fits], feet[fits, None], angles[fits, None])
            fits[fits] = gap >= -1e-6
        found[number, near] = fits
    return found


def _thrown(scene: Scene, sets: list[tuple[tuple[Connection, ...], Mask]]) -> list[bool]:
    """Which arms may throw the box to its goal: they do not hold it there, but nearly."""
    if "flight" not in scene.allow or scene.arrival_speed <= 0:
        return [False] * len(sets)
    reach = chain_stretch(scene, 1) + FLIGHT
    return [
        not mask[:, 1].any()
        and all(
            span(anchor_wrist(scene, c.root), side_wrist(scene, c.side, scene.goal_place)) <= reach
            for c in arms
        )
        for arms, mask in sets
    ]


def _legs_left(
    sets: list[tuple[tuple[Connection, ...], Mask]], thrown: list[bool], places: int
) -> Index:
    """Fewest legs (n,) from every place to the goal, `places` where none lead there."""
    left = np.full(places, places)
    left[1] = 0
    if any(thrown) and not any(mask[:, 1].any() for _, mask in sets):
        for (_, mask), may in zip(sets, thrown, strict=True):
            if may:
                left[mask.any(axis=0)] = 1
        left[1] = 0
    return _spread(sets, left)


def _carried_legs(sets: list[tuple[tuple[Connection, ...], Mask]], to: int, places: int) -> Index:
    """Fewest carried legs (n,) from every place to one of them, `places` where none lead there."""
    left = np.full(places, places)
    left[to] = 0
    return _spread(sets, left)


def _spread(sets: list[tuple[tuple[Connection, ...], Mask]], left: Index) -> Index:
    """Legs left (n,) where they are fewer by way of places that are known."""
    for legs in range(1, len(left)):
        before = left == legs - 1
        after = left.copy()
        for _, mask in sets:
            joined = mask[(mask & before).any(axis=1)].any(axis=0)
            after[joined] = np.minimum(after[joined], legs)
        if (after == left).all() and not before.any():
            break
        left = after
    return left


def _onward(
    mask: Mask, here: int, left: Index, may_throw: bool, places: Array
) -> Iterator[tuple[int, bool]]:
    """Places to go on to with one leg less to go, and whether the box is thrown there."""
    joined = np.asarray(mask[mask[:, here]].any(axis=0))
    if joined[1]:
        yield 1, False
        return
    if may_throw and left[here] == 1:
        yield 1, True
        return
    onward = np.flatnonzero(joined & (left == left[here] - 1))
    # In the middle between here and the goal there is most room to either side
    middle = (places[here] + places[1])[:2] / 2
    away = np.linalg.norm(places[onward, :2] - middle, axis=1)
    for there in onward[np.argsort(away, kind="stable")[:_NEXT]]:
        yield int(there), False


def _same(one: tuple[Connection, ...], other: tuple[Connection, ...]) -> bool:
    return {c.root for c in one} == {c.root for c in other}


def _tuple(point: Array) -> Place:
    return tuple(float(value) for value in point)
