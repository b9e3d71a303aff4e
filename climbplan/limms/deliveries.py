"""Several boxes, brought to their goals in the order of the spec, one after the other.

A search in depth over tasks: a task brings one box to its goal or puts it aside, by a course of one
leg or more, from wherever the modules are, with all other boxes as obstacles. A box is put aside
where it is in the way: where it stands at another one's goal, or where that one was not brought
with it there. Places aside are those from which it comes to its own goal in the fewest legs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.assembly import initial
from climbplan.limms.attempts import Attempts
from climbplan.limms.between_legs import Settle, as_it_is, put_down
from climbplan.limms.corridor import way_length
from climbplan.limms.courses import relays
from climbplan.limms.direct import search
from climbplan.limms.means import by_first_ends, carrying, legs_left, places_of
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.motions import Motions
from climbplan.limms.placement import centre_of, wrapped, yaw_of
from climbplan.limms.refusal import proof
from climbplan.limms.scene import Array, Scene, with_box_first, without_others
from climbplan.limms.timeline import NOWHERE, STABLE, PlanSoFar

_PLACES = 3  # aside, that are tried for one box
_APART = 0.25  # [m] between them
_ROOM = 0.02  # [m] between a box aside and where other boxes stand or go
_KEPT = 0.3  # [m] of room beyond which no place aside is better
_MOST = 4  # courses that are tried for one task


@dataclass(frozen=True)
class Task:
    """One box from where it stands to a place."""

    box: int
    goal: Array  # (4,) centre and yaw [m, rad]
    is_last: bool  # nothing comes after it
    aside: bool


@dataclass
class Found:
    """Everything until all boxes are at their goals, and the tasks in words."""

    world: PlanSoFar
    words: tuple[str, ...]


class Deliveries:
    """The search of one scene with several boxes."""

    def __init__(
        self,
        scene: Scene,
        attempts: Attempts,
        rng: np.random.Generator,
        most_steps: int,
        last: Settle = as_it_is,
    ) -> None:
        """most_steps: of legs that walk; last: what follows when all boxes are at their goals."""
        self.scene, self.attempts, self.rng = scene, attempts, rng
        self.most_steps, self.last = most_steps, last
        self.tried = 0  # courses
        # Centre and yaw (B, 4) of all boxes, and of their goals
        self.starts = np.column_stack([scene.box_start, scene.start_yaws])
        self.goals = np.column_stack([scene.goals, scene.goal_yaws])

    def plan(self) -> Found:
        """All boxes at their goals.

        Raises:
            Infeasible: one of the boxes cannot be brought to its goal, even without the others.
            LimitReached: nothing was found, or not with the budget.
        """
        for box in range(self.scene.deliveries):
            _require_possible(self.scene, box)
        found = self._onward(self.start(), self.starts, 0, self.scene.deliveries)
        if found is None:
            raise LimitReached(
                f"no order of putting {self.scene.deliveries} boxes aside and bringing them to "
                "their goals led to a plan, and none was proved impossible. "
                + self.attempts.story(),
                stage="motion",
            )
        return found

    def start(self) -> Found:
        """Everything where the spec has it."""
        return Found(initial(self.scene), ())

    def _onward(self, begin: Found, places: Array, box: int, spare: int) -> Found | None:
        """From where all boxes before `box` are at their goals; spare: tasks aside at most."""
        scene = self.scene
        if box == scene.deliveries:
            return begin
        if _same(places[box], self.goals[box]):
            return self._onward(begin, places, box + 1, spare)
        waiting = range(box + 1, scene.deliveries)
        in_way = [b for b in waiting if _overlap(scene, box, self.goals[box], b, places[b])]
        if not in_way:
            goal = Task(box, self.goals[box], box == scene.deliveries - 1, False)
            found = self._done(begin, places, goal, box + 1, spare)
            if found is not None:
                return found
        if not spare:
            return None
        for other in in_way[:1] or waiting:
            for place in self.aside(begin.world, places, other, box):
                # A box that does not turn is put aside as it stands
                goal_aside = np.array(
                    [*centre_of(place), *(place[3:] if len(place) == 4 else places[other, 3:])]
                )
                task = Task(other, goal_aside, False, True)
                found = self._done(begin, places, task, box, spare - 1)
                if found is not None:
                    return found
        return None

    def _done(self, begin: Found, places: Array, task: Task, box: int, spare: int) -> Found | None:
        """With a task done, and all that comes after it."""
        found = self._way(begin, places, task)
        if found is None:
            return None
        after = places.copy()
        after[task.box] = task.goal
        return self._onward(found, after, box, spare)

    def _way(self, begin: Found, places: Array, task: Task) -> Found | None:
        """A task done in the cheapest way that leads to a motion."""
        scene = self._scene(begin.world, places, task.box, task.goal, task.is_last)
        world = begin.world.copy()
        world.scene, world.box_mode = scene, STABLE
        world.box, world.yaw = scene.box_start[0].copy(), float(scene.start_yaws[0])
        motions = Motions(
            world, self.attempts, self.rng, self.most_steps, self.last if task.is_last else put_down
        )
        which = f"box {task.box}" + (" aside" if task.aside else "")
        listed = 0
        for course in islice(relays(world, 1), _MOST):
            listed += 1
            name = course.named(scene).removeprefix("relay: ")
            self.attempts.begin(f"{which}, {name}")
            self.tried += 1
            told = len(self.attempts.notes)
            found = motions.plan(course)
            if found is not None:
                return Found(found, (*begin.words, f"{which} by {name}"))
            if len(self.attempts.notes) == told:
                self.attempts.notes.append(f"{which}, {name}: no module can take its part")
        if not listed:
            self.attempts.notes.append(f"{which}: no arms bring it there in any number of legs")
        return None

    def _scene(
        self, world: PlanSoFar, places: Array, box: int, goal: Array, is_last: bool
    ) -> Scene:
        """A task's scene: that box first, modules where they are now."""
        speed = self.scene.arrival_speed if is_last else 0.0
        scene = with_box_first(self.scene, box, places, goal, speed)
        on_ground = (world.grounded == 0) & (world.base_anchor == NOWHERE)
        stand = np.where(on_ground[:, None], world.base_position, scene.stand)
        return replace(scene, stand=stand)

    def aside(self, world: PlanSoFar, places: Array, box: int, first: int) -> list[Array]:
        """Places for a box out of the way of all that are still to be brought, best first."""
        scene = self._scene(world, places, box, self.goals[box], False)
        spots, first_ends = places_of(scene), by_first_ends(world)
        there, onward = (
            legs_left(carrying(seen, spots, first_ends), to, len(spots))[2:]
            for seen, to in ((scene, 0), (without_others(scene), 1))
        )
        spots = spots[2:]
        others = [b for b in range(scene.boxes) if b != box]
        coming = [b for b in range(first, self.scene.deliveries) if b != box]
        taken = np.array([*(places[b] for b in others), *(self.goals[b] for b in coming)])
        sizes = self.scene.box_size / 2
        room = np.full(len(spots), np.inf)
        for number, (*centre, yaw) in zip(others + coming, taken, strict=True):
            block = np.array(centre), np.array(yaw), sizes[number]
            gap = upright_gap(centre_of(spots), yaw_of(spots), sizes[box], *block)
            room = np.minimum(room, gap)
        legs = there + onward
        open_ = np.flatnonzero((room >= _ROOM) & (legs < len(spots)))
        here = places[box, : spots.shape[1]]
        way = way_length(spots, here)
        ranked = sorted(open_, key=lambda k: (legs[k], -min(float(room[k]), _KEPT), way[k]))
        chosen: list[Array] = []
        for k in ranked:
            if len(chosen) == _PLACES:
                break
            if all(way_length(spots[k], o) >= _APART for o in (here, *chosen)):
                chosen.append(spots[k])
        if not chosen:
            self.attempts.notes.append(f"box {box} aside: there is no place from which it comes on")
        return chosen


def _overlap(scene: Scene, box: int, place: Array, other: int, its_place: Array) -> bool:
    """Whether two boxes at these places (4,) reach into each other."""
    one, its = (
        (centre_of(each), yaw_of(each), scene.box_size[b] / 2)
        for each, b in ((place, box), (its_place, other))
    )
    return bool(upright_gap(*one, *its) < -1e-6)


def _same(place: Array, goal: Array) -> bool:
    """Whether a box at a place (4,) is at a goal (4,)."""
    turned = float(wrapped(place[3] - goal[3]))
    return bool(np.abs(place[:3] - goal[:3]).max() < 1e-9 and abs(turned) < 1e-9)


def _require_possible(scene: Scene, box: int) -> None:
    """Raise Infeasible if a box cannot be brought to its goal, were it the only one.

    Parked boxes stay; others may be anywhere, so that what their places rule out is no proof.
    """
    starts = np.column_stack([scene.box_start, scene.start_yaws])
    goals = np.column_stack([scene.goals, scene.goal_yaws])
    if _same(starts[box], goals[box]):
        return
    speed = scene.arrival_speed if box == scene.deliveries - 1 else 0.0
    alone = without_others(with_box_first(scene, box, starts, goals[box], speed))
    proved = proof(alone, search(alone).conflicts)
    if proved is not None:
        raise Infeasible(
            f"box {box}, were it the only one: {proved}", proved.conflicts, stage="modes"
        )
