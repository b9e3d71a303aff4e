"""Courses of legs that bring the box to its goal, cheapest first: one search over where it stands.

States are places where the box stands, with the action that it came there by; an action carries,
throws or walks it from one place to the next (`means.py`). The fewest legs that lead to the goal
are what no course over the same places goes below: with the modules that hold the box so far they
are the bound that orders the search. A single leg is a course, too; those are listed from bounds
alone, and places are looked at where no single leg is as cheap as two.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count

import numpy as np

from climbplan.limms.actions import SECOND_LEG, Action, Course, Leg, place_of
from climbplan.limms.corridor import way_length
from climbplan.limms.means import Means, all_means, legs_left, places_of
from climbplan.limms.scene import Array, Index
from climbplan.limms.timeline import PlanSoFar

MOST = 10  # courses that are listed of one kind: the same kinds of actions in the same order
ALIKE = 2  # of them, with the same arms one after the other
CHEAPEST = 1.0 + SECOND_LEG  # cost of the cheapest course of two legs
_NEXT = 3  # places that are gone on from, of each state and action, by each guide
_SWITCH = 0.3  # other anchors than in the leg before
_APART = 0.01  # of the cost, for what courses of as many legs and modules differ by
_DETOUR = 0.7  # cost of a leg more than the fewest


def courses(world: PlanSoFar, direct: Sequence[Action]) -> Iterator[Course]:
    """All courses from where everything is to the goal of the world's scene, cheapest first.

    direct: actions that may bring the box there at once, cheapest first.
    """
    scene = world.scene
    begin, end = place_of(scene.start_place), place_of(scene.goal_place)
    single = [Course((Leg(action, begin, end),)) for action in direct]
    first = [course for course in single if course.cost() < CHEAPEST]
    yield from first
    # Nothing of what takes several legs is computed before it is asked for
    yield from heapq.merge(single[len(first) :], relays(world), key=Course.cost)


def relays(world: PlanSoFar, fewest: int = 2) -> Iterator[Course]:
    """Courses of `fewest` legs and more: as many as the fewest that there can be, or one more."""
    places = places_of(world.scene)
    means = all_means(world, places)
    plain = [m for m in means if m.action.kind == "arms" and not m.action.is_chained]
    if not any(m.end[:, 1].any() for m in plain):  # else throws are no shorter a way
        plain += [m for m in means if m.action.kind == "throw"]
    without_legs = [m for m in means if m.action.kind != "quadruped"]
    guides = [legs_left(plain, 1, len(places))]
    for more in (without_legs, means):
        guide = legs_left(more, 1, len(places))
        if (guide != guides[-1]).any():
            guides.append(guide)
    every = guides[-1]
    if every[0] < len(places):
        yield from _searched(places, means, guides, fewest)


def _searched(
    places: Array, means: Sequence[Means], guides: Sequence[Index], fewest: int
) -> Iterator[Course]:
    """Best first. guides: fewest legs from every place, by more and more actions."""
    least = next(int(guide[0]) for guide in guides if guide[0] < len(places))
    most, left = max(least, fewest - 1) + 1, guides[-1]
    number = count()
    queue: list[tuple[float, int, int, int, Course | None]] = [(0.0, next(number), 0, -1, None)]
    listed: Counter[tuple[tuple[str, bool], ...]] = Counter()
    alike: Counter[tuple[Action, ...]] = Counter()
    visits = np.zeros((len(places), len(means) + 1), int)
    while queue:
        _, _, here, before, course = heapq.heappop(queue)
        legs = () if course is None else course.legs
        if course is not None and here == 1:
            kinds = tuple((leg.action.kind, leg.action.is_chained) for leg in legs)
            actions = tuple(leg.action for leg in legs)
            if listed[kinds] < MOST and alike[actions] < ALIKE:
                listed[kinds] += 1
                alike[actions] += 1
                yield course
            continue
        visits[here, before] += 1
        if visits[here, before] > 1 or visits[here].sum() > MOST:
            continue
        for k, each in enumerate(means):
            if not each.begin[:, here].any() or (k == before and each.action.kind == "quadruped"):
                continue
            switch = _SWITCH
            if before >= 0 and _roots(each.action) == _roots(means[before].action):
                switch = 0.0
            for there in _onward(each, here, guides, places, len(legs), (fewest, most)):
                leg = Leg(each.action, place_of(places[here]), place_of(places[there]))
                way = float(way_length(places[here], places[there]))
                apart = _APART * (0.1 * each.action.modules + 0.2 * way + switch)
                apart += _DETOUR * (
                    max(len(legs) + 1 + int(left[there]) - least, 0)
                    - max(len(legs) + int(left[here]) - least, 0)
                )
                onward = Course((*legs, leg), apart + (course.apart if course else 0.0))
                bound = onward.cost() + SECOND_LEG * int(left[there])
                heapq.heappush(queue, (bound, next(number), there, k, onward))


def _onward(
    means: Means,
    here: int,
    guides: Sequence[Index],
    places: Array,
    before: int,
    legs: tuple[int, int],
) -> Iterator[int]:
    """Places to go on to after `before` legs; legs: fewest and most of a whole course."""
    joined = means.onward(here)
    if joined[1] and before + 1 >= legs[0]:
        yield 1
        return
    joined[[0, 1, here]] = False
    # In the middle between here and the goal there is most room to either side
    away = np.linalg.norm(places[:, :2] - (places[here] + places[1])[:2] / 2, axis=1)
    chosen: dict[int, None] = {}
    for left in guides:
        onward = np.flatnonzero(joined & (before + 1 + left <= legs[1]))
        order = np.lexsort((away[onward], left[onward]))[:_NEXT]
        chosen |= dict.fromkeys(int(there) for there in onward[order])
    yield from chosen


def _roots(action: Action) -> set[int]:
    return {connection.root for connection in action.connections}
