"""States between legs: where all boxes stand, and on which anchors modules hang.

Which module it is does not matter, as modules are alike, but for those that hold on to a wall by
their first ends: they do not come down. How many modules an action takes from the ground, and how
many have to come down for it, is counted; between which places it may bring a box is a relaxation
(`means.py`), with all other boxes where they stand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.courses.holding import Known
from climbplan.limms.courses.means import Means, all_means, by_first_ends, legs_left, places_of
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import on_ground
from climbplan.limms.scene.corridor import CLEARANCE
from climbplan.limms.scene.limms_scene import Scene, stands_at_goal, with_box_first, without_others
from climbplan.limms.scene.placement import centre_of, yaw_of

START, GOAL = 0, 1  # the first two places of each box
_ROOM = 0.02  # [m] between a box that is put down and where others stand or go
_KEPT = 0.3  # [m] of room beyond which no place is better


class State(NamedTuple):
    """All boxes stand, and nothing is latched to them."""

    at: tuple[int, ...]  # of each box to deliver: which of its places
    latched: tuple[int, ...]  # anchors of the terrain, each as often as modules hang on it

    @property
    def delivered(self) -> int:
        """How many boxes are at their goals, where they come in order."""
        return next((k for k, at in enumerate(self.at) if at != GOAL), len(self.at))


class Change(NamedTuple):
    """What an action does to latches."""

    latched: tuple[int, ...]  # after it
    moves: int  # of modules to an anchor, or down from one


@dataclass(frozen=True)
class BoxPlaces:
    """Where one box may stand, were it the only one."""

    places: Array  # (n, D) start, goal, and where it can be put down [m, rad]
    guides: tuple[IntArray, ...]  # fewest legs (n,) to its goal, by more and more actions

    @property
    def left(self) -> IntArray:
        """Fewest legs (n,) by all actions: no course over the same places has fewer."""
        return self.guides[-1]


class Space:
    """What can be done from each state; computed where a search comes to it."""

    def __init__(self, world: PlanSoFar) -> None:
        """world: where everything is at first, its scene with boxes in the order of the plan."""
        self.scene = scene = world.scene
        self.by_first = by_first_ends(world)
        anchors = [int(a) - scene.wall_offset for a in scene.held if a >= 0]
        # One of several that stands at its goal stays
        at = tuple(
            GOAL if scene.deliveries > 1 and stands_at_goal(scene, k) else START
            for k in range(scene.deliveries)
        )
        self.first = State(at, tuple(sorted(anchors)))
        self._means: dict[tuple[int, tuple[int, ...]], list[Means]] = {}
        self._known: list[Known] = [{} for _ in range(scene.deliveries)]
        self._in_way: dict[tuple[int, int, int], bool] = {}
        self.boxes = [self._box(k) for k in range(scene.deliveries)]

    def means(self, box: int, state: State) -> list[Means]:
        """Actions that may bring a box somewhere while all others stand as in a state."""
        others = _others(box, state)
        if (box, others) not in self._means:
            where = self._starts()
            for k, at in enumerate(state.at):
                if k != box:
                    where[k] = self.placed(k, at)
            scene, places = self._seen(box, where), self.boxes[box].places
            taken = [(k, where[k]) for k in range(len(state.at)) if k != box]
            free = self._gap(box, places, taken) >= CLEARANCE
            self._means[box, others] = [
                Means(each.action, each.begin & free, each.end & free)
                for each in all_means(scene, places, self.by_first, self._known[box])
            ]
        return self._means[box, others]

    def placed(self, box: int, at: int) -> Array:
        """One of the places of a box as centre and yaw (4,) [m, rad]."""
        place = self.boxes[box].places[at]
        return np.array([*centre_of(place), yaw_of(place)])

    def room(self, box: int, state: State) -> Array:
        """Room (n,) round the places of a box to where others stand or are still to go [m].

        At most as much as matters; minus infinity where there is too little.
        """
        taken = [
            (k, self.placed(k, other))
            for k, at in enumerate(state.at)
            if k != box
            for other in ({at, GOAL} if k >= state.delivered else {at})
        ]
        room = np.minimum(self._gap(box, self.boxes[box].places, taken), _KEPT)
        return np.where(room < _ROOM, -np.inf, room)

    def _gap(self, box: int, places: Array, others: Sequence[tuple[int, Array]]) -> Array:
        """Gaps (n,) between a box at places (n, D) and others, each with its place (4,) [m]."""
        sizes, least = self.scene.box_size / 2, np.full(len(places), np.inf)
        for k, place in others:
            block = place[:3], place[3], sizes[k]
            gap = upright_gap(centre_of(places), yaw_of(places), sizes[box], *block)
            least = np.minimum(least, gap)
        return least

    def is_in_way(self, box: int, at: int, other: int) -> bool:
        """Whether a box at one of its places overlaps the goal of another one."""
        if (box, at, other) not in self._in_way:
            goal = (other, self.placed(other, GOAL))
            gap = self._gap(box, self.placed(box, at)[None], [goal])
            self._in_way[box, at, other] = bool(gap[0] < -1e-6)
        return self._in_way[box, at, other]

    def change(self, state: State, action: Action) -> Change | None:
        """Latches after an action; None where there are too few modules for it.

        Modules that are not needed stay; of others those come down that hang nearest to where
        they are needed.
        """
        hanging = Counter(state.latched)
        roots = [connection.root for connection in action.connections]
        relatches = action.kind == "relatch"
        if any(hanging[root] > (0 if relatches else 1) for root in roots):
            return None
        kept = Counter({root: 1 for root in roots if hanging[root]})
        needed = action.modules - kept.total()
        short = max(needed - (self.scene.count - hanging.total()), 0)
        fixed = set() if relatches else {a for a in self.by_first if not on_ground(self.scene, a)}
        free = [a for a, n in hanging.items() if n == 1 and a not in fixed and a not in kept]
        if short > len(free):
            return None
        free.sort(key=lambda anchor: (self._nearest(anchor, roots), anchor))
        down = Counter(free[:short])
        after = hanging - down - kept
        for connection in action.connections:
            after[connection.root] += connection.links
        return Change(tuple(sorted(after.elements())), needed + short)

    def _nearest(self, anchor: int, roots: Sequence[int]) -> float:
        where = self.scene.wall_position
        return min((float(np.linalg.norm(where[anchor] - where[r])) for r in roots), default=0.0)

    def _box(self, box: int) -> BoxPlaces:
        alone = without_others(self._seen(box, self._starts()))
        places = places_of(alone)
        means = all_means(alone, places, self.by_first, self._known[box])
        if self.scene.deliveries == 1:
            self._means[box, _others(box, self.first)] = means
        return BoxPlaces(places, _guides(means, len(places)))

    def _starts(self) -> Array:
        """Centre and yaw (B, 4) of all boxes at first [m, rad]."""
        return np.column_stack([self.scene.box_start, self.scene.start_yaws])

    def _seen(self, box: int, where: Array) -> Scene:
        """The scene of one box on its way to its goal, all others where they are (B, 4)."""
        goal = np.array([*self.scene.goals[box], self.scene.goal_yaws[box]])
        is_last = box == self.scene.deliveries - 1
        return with_box_first(
            self.scene, box, where, goal, self.scene.arrival_speed if is_last else 0.0
        )


def _others(box: int, state: State) -> tuple[int, ...]:
    return state.at[:box] + state.at[box + 1 :]


def _guides(means: Sequence[Means], places: int) -> tuple[IntArray, ...]:
    """Fewest legs (n,) from every place to the goal, by plain arms first, then by more actions."""
    plain = [m for m in means if m.action.kind == "arms" and not m.action.is_chained]
    if not any(m.end[:, GOAL].any() for m in plain):  # else throws are no shorter a way
        plain += [m for m in means if m.action.kind == "throw"]
    without_legs = [m for m in means if m.action.kind != "quadruped"]
    guides = [legs_left(plain, GOAL, places)]
    for more in (without_legs, means):
        guide = legs_left(more, GOAL, places)
        if (guide != guides[-1]).any():
            guides.append(guide)
    return tuple(guides)
