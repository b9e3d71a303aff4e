"""Courses of legs that bring all boxes to their goals, cheapest first: one search over states.

A state says where the boxes stand and which anchors modules hang on (`states.py`); an action
carries, throws or walks one box from place to place. Boxes come to their goals in order, and one
that is not to come next may be put aside. The fewest legs that lead to the goals, of each box as if
it were the only one, are what no course over the same places goes below: with the modules that hold
a box so far they are the bound that orders the search. A single leg is a course, too; those are
listed from bounds alone, and places are looked at where no single leg is as cheap as two.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.courses.means import Means
from climbplan.limms.courses.states import GOAL, START, Space, State
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import SECOND_LEG, Action, Course, Leg, place_of
from climbplan.limms.scene.corridor import way_length

MOST = 10  # courses that are listed of one kind: the same kinds of actions in the same order
ALIKE = 2  # of them, with the same arms one after the other
CHEAPEST = 1.0 + SECOND_LEG  # cost of the cheapest course of two legs
_NEXT = 3  # places that are gone on from, of each state and action, by each guide
_SWITCH = 0.3  # of each module that comes to an anchor, or down from one
_APART = 0.01  # of the cost, for what courses of as many legs and modules differ by
_DETOUR = 0.7  # cost of a leg more than the fewest


def courses(world: PlanSoFar, direct: Sequence[Action]) -> Iterator[Course]:
    """All courses from where everything is to the goal of the world's scene, cheapest first.

    direct: actions that may bring its only box there at once, cheapest first.
    """
    scene = world.scene
    begin, end = place_of(scene.start_place), place_of(scene.goal_place)
    single = [Course((Leg(action, begin, end),)) for action in direct]
    first = [course for course in single if course.cost() < CHEAPEST]
    yield from first
    # Nothing of what takes several legs is computed before it is asked for
    yield from heapq.merge(single[len(first) :], relays(world), key=Course.cost)


def relays(world: PlanSoFar, fewest: int = 2) -> Iterator[Course]:
    """Courses of `fewest` legs and more: as many as the fewest that there can be, or a leg more for
    each box. World: its scene with boxes in the order of the plan."""
    space = Space(world)
    first = zip(space.boxes, space.first.at, strict=True)
    if all(box.left[at] < len(box.places) for box, at in first):
        yield from _Search(space, fewest).found()


class _Search:
    """Best first over states."""

    def __init__(self, space: Space, fewest: int) -> None:
        self.space, self.fewest = space, fewest
        self.left = [box.left for box in space.boxes]
        self.least = sum(
            next(int(guide[at]) for guide in box.guides if guide[at] < len(box.places))
            for box, at in zip(space.boxes, space.first.at, strict=True)
        )
        self.most = max(self.least, fewest - 1) + len(space.boxes)

    def found(self) -> Iterator[Course]:
        """All courses, cheapest first, not more than a few that are alike."""
        number = count()
        queue: list[tuple[float, int, State, Course | None]] = [
            (0.0, next(number), self.space.first, None)
        ]
        listed: Counter[tuple[tuple[int, str, bool], ...]] = Counter()
        alike: Counter[tuple[tuple[int, Action], ...]] = Counter()
        visits: Counter[tuple[State, Action | None]] = Counter()
        seen: Counter[tuple[int, ...]] = Counter()
        while queue:
            _, _, state, course = heapq.heappop(queue)
            if course is not None and state.delivered == len(state.at):
                kinds = tuple((x.box, x.action.kind, x.action.is_chained) for x in course.legs)
                actions = tuple((leg.box, leg.action) for leg in course.legs)
                if listed[kinds] < MOST and alike[actions] < ALIKE:
                    listed[kinds] += 1
                    alike[actions] += 1
                    yield course
                continue
            before = (state, course.legs[-1].action if course else None)
            visits[before] += 1
            seen[state.at] += 1
            if visits[before] > 1 or seen[state.at] > MOST:
                continue
            for after, onward in self._onward(state, course):
                bound = onward.cost() + SECOND_LEG * self._legs_left(after)
                heapq.heappush(queue, (bound, next(number), after, onward))

    def _legs_left(self, state: State) -> int:
        """Fewest legs from a state, by all actions.

        A box at the goal of one that comes before it has to stand somewhere else meanwhile.
        """
        legs = 0
        for box, (left, at) in enumerate(zip(self.left, state.at, strict=True)):
            fewest = int(left[at])
            earlier = range(state.delivered, box)
            if fewest < 2 and any(self.space.is_in_way(box, at, other) for other in earlier):
                fewest = 2
            legs += fewest
        return legs

    def _onward(self, state: State, course: Course | None) -> Iterator[tuple[State, Course]]:
        """All states that one leg more leads to."""
        legs = () if course is None else course.legs
        before = max(len(legs) + self._legs_left(state) - self.least, 0)
        for box in range(state.delivered, len(state.at)):
            places, here = self.space.boxes[box].places, state.at[box]
            for means in self.space.means(box, state):
                action = means.action
                walks_on = bool(legs) and legs[-1].box == box and legs[-1].action == action
                change = self.space.change(state, action)
                if change is None or (walks_on and action.kind == "quadruped"):
                    continue
                for there in self._places(means, box, state, len(legs)):
                    after = State((*state.at[:box], there, *state.at[box + 1 :]), change.latched)
                    leg = Leg(
                        action,
                        place_of(places[here]),
                        place_of(places[there]),
                        box,
                        aside=there != GOAL,
                    )
                    way = float(way_length(places[here], places[there]))
                    apart = _APART * (0.1 * action.modules + 0.2 * way + _SWITCH * change.moves)
                    detour = max(len(legs) + 1 + self._legs_left(after) - self.least, 0)
                    apart += _DETOUR * (detour - before) + (course.apart if course else 0.0)
                    yield after, Course((*legs, leg), apart)

    def _places(self, means: Means, box: int, state: State, legs: int) -> Iterator[int]:
        """Places to bring a box to after `legs` legs, straight to its goal if that can be."""
        here, own = state.at[box], self.space.boxes[box]
        joined = means.onward(here)
        is_next = box == state.delivered
        others = self._legs_left(state._replace(at=(*state.at[:box], GOAL, *state.at[box + 1 :])))
        if joined[GOAL] and is_next and legs + others + 1 >= self.fewest:
            yield GOAL
            return
        room = self.space.room(box, state)
        joined = joined & (room > 0)
        joined[[START, GOAL, here]] = False
        chosen: dict[int, None] = {}
        for guide in own.guides:
            onward = np.flatnonzero(joined & (legs + 1 + guide + others <= self.most))
            order = np.lexsort((self._away(own.places, here)[onward], -room[onward], guide[onward]))
            chosen |= dict.fromkeys(int(there) for there in onward[order[:_NEXT]])
        yield from chosen

    @staticmethod
    def _away(places: Array, here: int) -> Array:
        """How far places (n,) are from the middle of here and the goal: there is most room [m]."""
        middle = (places[here] + places[GOAL])[:2] / 2
        away: Array = np.linalg.norm(places[:, :2] - middle, axis=1)
        return away
