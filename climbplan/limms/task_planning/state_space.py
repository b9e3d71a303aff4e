"""States between subtasks: where all boxes stand, and on which anchors modules hang.

Modules are identical, so a state does not say which module hangs where. Exceptions are modules
whose first ends hold a wall: they do not come down. For each action the state space counts modules
taken from the ground and modules that must come down. Between which places an action may bring a
box is a relaxation (`relaxed_actions.py`), with all other boxes where they stand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import compute_ground_end_frame
from climbplan.limms.scene.corridor import CLEARANCE
from climbplan.limms.scene.limms_scene import (
    ModuleScene,
    is_at_goal,
    put_box_first,
    remove_other_boxes,
)
from climbplan.limms.scene.placement import centre_of, yaw_of
from climbplan.limms.task_planning.reachability import HoldingCache
from climbplan.limms.task_planning.relaxed_actions import (
    RelaxedAction,
    compute_cost_to_go,
    find_first_end_anchors,
    list_places,
    relax_actions,
)

START, GOAL = 0, 1  # the first two places of each box
_MIN_CLEARANCE = 0.02  # [m] between a box that is put down and where others stand or go
_MAX_CLEARANCE = 0.3  # [m] beyond which more clearance makes no place better


class TaskState(NamedTuple):
    """A state in which all boxes stand and nothing is latched to them."""

    place_indices: tuple[int, ...]  # index of the place of each box to deliver
    latched: tuple[int, ...]  # terrain anchors, each as often as modules hang on it

    @property
    def delivered(self) -> int:
        """The number of boxes at their goals, counted in the order of delivery."""
        return next(
            (box for box, index in enumerate(self.place_indices) if index != GOAL),
            len(self.place_indices),
        )


class LatchEffect(NamedTuple):
    """The effect of an action on latches."""

    latched: tuple[int, ...]  # terrain anchors after the action
    num_moves: int  # modules that come to an anchor or down from one


@dataclass(frozen=True)
class BoxPlaces:
    """Where one box may stand if it were the only one."""

    places: Array  # (n, D) start, goal, and where it can be put down [m, rad]
    heuristics: tuple[IntArray, ...]  # fewest subtasks (n,) to its goal, by growing sets of actions

    @property
    def cost_to_go(self) -> IntArray:
        """Fewest subtasks (n,) by all actions: no task plan over the same places has fewer."""
        return self.heuristics[-1]


class StateSpace:
    """The actions from each state, computed lazily as a search reaches it."""

    def __init__(self, partial_plan: PartialPlan) -> None:
        """Initialise from where everything is; the scene has boxes in the order of the plan."""
        self.scene = scene = partial_plan.scene
        self.first_end_anchors = find_first_end_anchors(partial_plan)
        anchors = [int(a) - scene.wall_offset for a in scene.start_anchor if a >= 0]
        # With several boxes, one that stands at its goal stays there
        indices = tuple(
            GOAL if scene.num_deliveries > 1 and is_at_goal(scene, box) else START
            for box in range(scene.num_deliveries)
        )
        self.initial = TaskState(indices, tuple(sorted(anchors)))
        self._relaxed: dict[tuple[int, tuple[int, ...]], list[RelaxedAction]] = {}
        self._caches: list[HoldingCache] = [{} for _ in range(scene.num_deliveries)]
        self._goal_overlaps: dict[tuple[int, int, int], bool] = {}
        self.boxes = [self._build_box_places(box) for box in range(scene.num_deliveries)]

    def find_actions(self, box: int, state: TaskState) -> list[RelaxedAction]:
        """Return actions that may move a box while all others stand as in a state."""
        other_places = _other_places(box, state)
        if (box, other_places) not in self._relaxed:
            placements = self._initial_placements()
            for other_box, index in enumerate(state.place_indices):
                if other_box != box:
                    placements[other_box] = self.compute_placement(other_box, index)
            scene, places = self._build_scene(box, placements), self.boxes[box].places
            occupied = [
                (other_box, placements[other_box])
                for other_box in range(len(state.place_indices))
                if other_box != box
            ]
            is_free = self._compute_gaps(box, places, occupied) >= CLEARANCE
            self._relaxed[box, other_places] = [
                RelaxedAction(relaxed.action, relaxed.begin & is_free, relaxed.end & is_free)
                for relaxed in relax_actions(
                    scene, places, self.first_end_anchors, self._caches[box]
                )
            ]
        return self._relaxed[box, other_places]

    def compute_placement(self, box: int, index: int) -> Array:
        """Return one of the places of a box as centre and yaw (4,) [m, rad]."""
        placement = self.boxes[box].places[index]
        return np.array([*centre_of(placement), yaw_of(placement)])

    def compute_clearances(self, box: int, state: TaskState) -> Array:
        """Return the clearance (n,) around places of a box to where others stand or will go [m].

        The clearance saturates at `_MAX_CLEARANCE`, and is minus infinity below `_MIN_CLEARANCE`.
        """
        occupied = [
            (neighbour, self.compute_placement(neighbour, target))
            for neighbour, index in enumerate(state.place_indices)
            if neighbour != box
            for target in ({index, GOAL} if neighbour >= state.delivered else {index})
        ]
        clearance = np.minimum(
            self._compute_gaps(box, self.boxes[box].places, occupied), _MAX_CLEARANCE
        )
        return np.where(clearance < _MIN_CLEARANCE, -np.inf, clearance)

    def _compute_gaps(
        self, box: int, places: Array, obstacles: Sequence[tuple[int, Array]]
    ) -> Array:
        """Return gaps (n,) between a box at places (n, D) and obstacles at places (4,) [m]."""
        half_sizes, min_gap = self.scene.box_size / 2, np.full(len(places), np.inf)
        for obstacle, placement in obstacles:
            block = placement[:3], placement[3], half_sizes[obstacle]
            gap = upright_gap(centre_of(places), yaw_of(places), half_sizes[box], *block)
            min_gap = np.minimum(min_gap, gap)
        return min_gap

    def overlaps_goal(self, box: int, index: int, other_box: int) -> bool:
        """Return whether a box at one of its places overlaps the goal of another one."""
        if (box, index, other_box) not in self._goal_overlaps:
            goal = (other_box, self.compute_placement(other_box, GOAL))
            gap = self._compute_gaps(box, self.compute_placement(box, index)[None], [goal])
            self._goal_overlaps[box, index, other_box] = bool(gap[0] < -1e-6)
        return self._goal_overlaps[box, index, other_box]

    def compute_latch_effect(self, state: TaskState, action: Action) -> LatchEffect | None:
        """Return the latches after an action, or None where it lacks modules.

        Modules that are not needed stay. Of the others, those nearest to the anchors of the action
        come down.
        """
        hanging = Counter(state.latched)
        roots = [connection.root for connection in action.connections]
        relatches = action.kind == "relatch"
        if any(hanging[root] > (0 if relatches else 1) for root in roots):
            return None
        reused = Counter({root: 1 for root in roots if hanging[root]})
        needed = action.num_modules - reused.total()
        num_missing = max(needed - (self.scene.num_modules - hanging.total()), 0)
        immovable = (
            set()
            if relatches
            else {a for a in self.first_end_anchors if not compute_ground_end_frame(self.scene, a)}
        )
        removable = [
            a for a, n in hanging.items() if n == 1 and a not in immovable and a not in reused
        ]
        if num_missing > len(removable):
            return None
        removable.sort(key=lambda anchor: (self._distance_to_nearest(anchor, roots), anchor))
        removed = Counter(removable[:num_missing])
        latched = hanging - removed - reused
        for connection in action.connections:
            latched[connection.root] += connection.links
        return LatchEffect(tuple(sorted(latched.elements())), needed + num_missing)

    def _distance_to_nearest(self, anchor: int, roots: Sequence[int]) -> float:
        """Return the distance from an anchor to the nearest of the roots [m]; zero without any."""
        positions = self.scene.wall_position
        return min(
            (float(np.linalg.norm(positions[anchor] - positions[r])) for r in roots), default=0.0
        )

    def _build_box_places(self, box: int) -> BoxPlaces:
        """Return places and heuristics of a box as if it were the only one."""
        scene = remove_other_boxes(self._build_scene(box, self._initial_placements()))
        places = list_places(scene)
        relaxed = relax_actions(scene, places, self.first_end_anchors, self._caches[box])
        if self.scene.num_deliveries == 1:
            self._relaxed[box, _other_places(box, self.initial)] = relaxed
        return BoxPlaces(places, _build_heuristics(relaxed, len(places)))

    def _initial_placements(self) -> Array:
        """Return centre and yaw (B, 4) of all boxes at the start [m, rad]."""
        return np.column_stack([self.scene.box_start, self.scene.start_yaws])

    def _build_scene(self, box: int, placements: Array) -> ModuleScene:
        """Return the scene that brings one box to its goal, all others at placements (B, 4)."""
        goal = np.array([*self.scene.goals[box], self.scene.goal_yaws[box]])
        is_last = box == self.scene.num_deliveries - 1
        return put_box_first(
            self.scene, box, placements, goal, self.scene.arrival_speed if is_last else 0.0
        )


def _other_places(box: int, state: TaskState) -> tuple[int, ...]:
    """Return the place indices of all boxes but one."""
    return state.place_indices[:box] + state.place_indices[box + 1 :]


def _build_heuristics(
    relaxed_actions: Sequence[RelaxedAction], num_places: int
) -> tuple[IntArray, ...]:
    """Return the fewest subtasks (n,) from each place to the goal, for growing sets of actions.

    The sets are single arms (with throws where no arm reaches the goal), all but the quadruped, and
    all actions.
    """
    simple = [
        relaxed
        for relaxed in relaxed_actions
        if relaxed.action.kind == "arms" and not relaxed.action.has_chains
    ]
    if not any(
        relaxed.end[:, GOAL].any() for relaxed in simple
    ):  # else throws take no fewer subtasks
        simple += [relaxed for relaxed in relaxed_actions if relaxed.action.kind == "throw"]
    without_quadruped = [
        relaxed for relaxed in relaxed_actions if relaxed.action.kind != "quadruped"
    ]
    heuristics = [compute_cost_to_go(simple, GOAL, num_places)]
    for actions in (without_quadruped, relaxed_actions):
        heuristic = compute_cost_to_go(actions, GOAL, num_places)
        if (heuristic != heuristics[-1]).any():
            heuristics.append(heuristic)
    return tuple(heuristics)
