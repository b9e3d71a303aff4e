"""Between which places the box may be brought by each action, by relaxations of what actions need.

Arms hold the box at places where the closed inverse has an answer within joint ranges that touches
nothing solid; a throw begins at such a place and ends at the goal; a module relatches where it
comes to the box first, and over it to its anchor; chains reach stretched out, and hold what they
have to; legs walk from ground to ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.courses.direct import FLIGHT, legs_misfit
from climbplan.limms.courses.holding import Known, held_at, stretched_to
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import (
    Connection,
    access,
    access_over_box,
    anchor_wrist,
    chain_stretch,
    holding_misfit,
    side_wrist,
    span,
)
from climbplan.limms.scene.corridor import centre_blocks, yaws_between
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.placement import extents, yaw_of

STEP = 0.12  # [m] between places
_CHAINS = 12  # sets of chains, those that serve most places


@dataclass(frozen=True)
class Means:
    """An action, and between which of n places: for some row, from its begins to its ends."""

    action: Action
    begin: BoolArray  # (rows, n)
    end: BoolArray  # (rows, n)

    def onward(self, here: int) -> BoolArray:
        """Places (n,) that it brings the box to from one of them."""
        return np.asarray(self.end[self.begin[:, here]].any(axis=0))

    def before(self, there: BoolArray) -> BoolArray:
        """Places (n,) from which it brings the box to some of those in `there` (n,)."""
        return np.asarray(self.begin[(self.end & there).any(axis=1)].any(axis=0))


def places_of(scene: Scene) -> Array:
    """Start, goal, and where the box can be put down (n, D) [m, rad]."""
    return np.vstack([scene.start_place, scene.goal_place, standing_spots(scene)])


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
    found: set[tuple[float, float, float]] = set()
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


def by_first_ends(world: PlanSoFar) -> frozenset[int]:
    """Anchors of the terrain, as those are numbered, that modules are on with their first ends."""
    offset, anchors = world.scene.wall_offset, len(world.scene.anchor_names)
    return frozenset(int(a) - offset for a in world.base_anchor if offset <= a < anchors)


def carrying(scene: Scene, places: Array, by_first: frozenset[int], known: Known) -> list[Means]:
    """Arms that hold the box: single ones where one latch does, else pairs."""
    if "arms" not in scene.allow:
        return []
    return [
        Means(Action("arms", arms), mask, mask)
        for arms, mask in _holding(scene, places, by_first, known)
        if mask.any()
    ]


def all_means(scene: Scene, places: Array, by_first: frozenset[int], known: Known) -> list[Means]:
    """All actions that may do something with the scene's first box.

    known: of the same box and places, beside fewer other boxes; what is not in it yet is added.
    """
    carried = carrying(scene, places, by_first, known)
    found = carried + list(_thrown(scene, carried, places))
    if "arms" in scene.allow:
        found += [*_relatched(scene, places, known), *_chained(scene, places)]
    return found + list(_walked(scene, places))


def legs_left(means: Sequence[Means], to: int, places: int) -> IntArray:
    """Fewest legs (n,) from every place to one of them, `places` where none lead there.

    No course over the same places has fewer.
    """
    left = np.full(places, places)
    left[to] = 0
    for legs in range(1, places):
        before = left == legs - 1
        if not before.any():
            break
        for each in means:
            joined = each.before(before)
            left[joined] = np.minimum(left[joined], legs)
    return left


def _holding(
    scene: Scene, places: Array, by_first: frozenset[int], known: Known
) -> list[tuple[tuple[Connection, ...], BoolArray]]:
    """Sets of arms that hold the box, and where they can, (branches, places)."""
    single: list[tuple[Connection, BoolArray]] = []
    for root in range(scene.walls):
        if access(scene, root):
            single += [
                (c, held_at(scene, c, places, root in by_first, known))
                for c in (Connection(root, side) for side in range(4))
            ]
    alone: list[tuple[tuple[Connection, ...], BoolArray]] = [
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


def _only_goal(like: BoolArray) -> BoolArray:
    """Rows that end at the goal."""
    end = np.zeros_like(like)
    end[:, 1] = True
    return end


def _thrown(scene: Scene, carried: Sequence[Means], places: Array) -> Iterator[Means]:
    """Throws to the goal by arms that do not hold the box there, but nearly."""
    if "flight" not in scene.allow or scene.arrival_speed <= 0:
        return
    reach = chain_stretch(scene, 1) + FLIGHT
    for each in carried:
        arms = each.action.connections
        if not each.end[:, 1].any() and all(
            span(anchor_wrist(scene, c.root), side_wrist(scene, c.side, places[1])) <= reach
            for c in arms
        ):
            yield Means(Action("throw", arms), each.begin, _only_goal(each.begin))


def _relatched(scene: Scene, places: Array, known: Known) -> Iterator[Means]:
    """One module over the box, to anchors that none comes to from the ground."""
    for root, side in product(range(scene.walls), range(4)):
        connection = Connection(root, side)
        if access(scene, root) or holding_misfit(scene, (connection,)):
            continue
        held = np.vstack([held_at(scene, connection, places, end, known) for end in (True, False)])
        if held.any():
            over = np.array([access_over_box(scene, connection, place) for place in places])
            yield Means(Action("relatch", (connection,)), held & over, held)


def _chained(scene: Scene, places: Array) -> list[Means]:
    """Arms on arms that bring the box to its goal: one where that holds it, else two."""
    single = [
        Connection(root, side, links)
        for root in range(scene.walls)
        if access(scene, root)
        for side in range(4)
        for links in range(1, min(scene.count, 2) + 1)
    ]
    reached = {c: stretched_to(scene, c, places) for c in single}
    single = [c for c in single if reached[c][1]]
    sets: list[tuple[Connection, ...]] = [(c,) for c in single if not holding_misfit(scene, (c,))]
    if not sets:
        sets = [
            (one, other)
            for one, other in combinations(single, 2)
            if one.root != other.root
            and one.side != other.side
            and not holding_misfit(scene, (one, other))
        ]
    found = []
    for arms in sets:
        if sum(c.links for c in arms) <= scene.count and any(c.links > 1 for c in arms):
            begin = np.all([reached[c] for c in arms], axis=0)[None]
            found.append(Means(Action("arms", arms), begin, _only_goal(begin)))
    found.sort(key=lambda each: -int(each.begin.sum()))
    return found[:_CHAINS]


def _walked(scene: Scene, places: Array) -> Iterator[Means]:
    """Four legs, from ground to ground or to the goal, the box as it stands at first."""
    if "quadruped" not in scene.allow or legs_misfit(scene):
        return
    plain = np.abs(yaw_of(places)) < 1e-12
    if plain[0]:
        row = plain[None]
        begin = row.copy()
        begin[:, 1] = False
        yield Means(Action("quadruped"), begin, row)
