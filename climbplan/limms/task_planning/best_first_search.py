"""Best-first search for task plans that bring all boxes to their goals, cheapest first.

This is symbolic task planning by forward state-space search (Ghallab, Nau and Traverso, Automated
Planning, 2004). A state says where the boxes stand and on which anchors modules hang
(`state_space.py`). An action carries, throws or walks one box from place to place. Boxes come to
their goals in order; a box that is not the next one may be set aside.

The heuristic is the number of subtasks from each box to its goal, summed over boxes and computed as
if each box were the only one. No plan over the same places has fewer subtasks. The cost so far plus
this bound orders the queue.

A single action is a task plan, too. Those plans are listed from bounds alone, and places are
searched only where no single action is as cheap as two subtasks.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import SUBTASK_COST, Action, Subtask, TaskPlan, freeze_placement
from climbplan.limms.scene.corridor import path_length
from climbplan.limms.task_planning.relaxed_actions import RelaxedAction
from climbplan.limms.task_planning.state_space import GOAL, START, StateSpace, TaskState

MAX_PLANS_PER_KIND = 10  # task plans with the same kinds of actions in the same order
MAX_PLANS_PER_ACTIONS = 2  # task plans of one kind with the same arms in the same order
MIN_COST_TWO_SUBTASKS = 1.0 + SUBTASK_COST  # lower bound on the cost of two subtasks
_MAX_SUCCESSORS = 3  # successors of each state and action, by each heuristic
_LATCH_CHANGE_COST = 0.3  # for each module that latches to an anchor or comes down
_SECONDARY_COST_WEIGHT = 0.01  # of costs that only order plans with equal subtasks and modules
_DETOUR_COST = 0.7  # cost of each subtask beyond the fewest


def list_task_plans(
    partial_plan: PartialPlan, single_actions: Sequence[Action]
) -> Iterator[TaskPlan]:
    """Yield task plans to the goal of the scene, cheapest first.

    The branching is capped: of each state the three best successors by each heuristic are kept, and
    of plans that visit the same states only the first.

    Args:
        partial_plan: Where box and modules are; its scene has one box to deliver.
        single_actions: Actions that may bring the box to its goal at once, cheapest first.
    """
    scene = partial_plan.scene
    start, goal = freeze_placement(scene.start_placement), freeze_placement(scene.goal_placement)
    single_plans = [TaskPlan((Subtask(action, start, goal),)) for action in single_actions]
    cheap_plans = [
        task_plan for task_plan in single_plans if task_plan.cost() < MIN_COST_TWO_SUBTASKS
    ]
    yield from cheap_plans
    # The search over places starts only when a plan of it is requested
    yield from heapq.merge(
        single_plans[len(cheap_plans) :], search_task_plans(partial_plan), key=TaskPlan.cost
    )


def search_task_plans(partial_plan: PartialPlan, min_subtasks: int = 2) -> Iterator[TaskPlan]:
    """Yield task plans with several subtasks, cheapest first.

    Args:
        partial_plan: Where all boxes and modules are; its scene has boxes in the order of the plan.
        min_subtasks: Least number of subtasks of a plan. Plans exceed it, or the fewest that lead
            to the goals, by at most one subtask for each box.
    """
    space = StateSpace(partial_plan)
    initial_places = zip(space.boxes, space.initial.place_indices, strict=True)
    if all(box.cost_to_go[index] < len(box.places) for box, index in initial_places):
        yield from _BestFirstSearch(space, min_subtasks).enumerate_plans()


class _BestFirstSearch:
    """A best-first search over the states of a `StateSpace`."""

    def __init__(self, space: StateSpace, min_subtasks: int) -> None:
        self.space, self.min_subtasks = space, min_subtasks
        self.cost_to_go = [box.cost_to_go for box in space.boxes]
        self.fewest_simple_subtasks = sum(
            next(
                int(heuristic[index])
                for heuristic in box.heuristics
                if heuristic[index] < len(box.places)
            )
            for box, index in zip(space.boxes, space.initial.place_indices, strict=True)
        )
        self.max_subtasks = max(self.fewest_simple_subtasks, min_subtasks - 1) + len(space.boxes)

    def enumerate_plans(self) -> Iterator[TaskPlan]:
        """Yield task plans, cheapest first, with at most a few similar ones."""
        tie_breaker = count()
        queue: list[tuple[float, int, TaskState, TaskPlan | None]] = [
            (0.0, next(tie_breaker), self.space.initial, None)
        ]
        num_of_kind: Counter[tuple[tuple[int, str, bool], ...]] = Counter()
        num_of_actions: Counter[tuple[tuple[int, Action], ...]] = Counter()
        visits: Counter[tuple[TaskState, Action | None]] = Counter()
        num_expanded: Counter[tuple[int, ...]] = Counter()
        while queue:
            _, _, state, task_plan = heapq.heappop(queue)
            if task_plan is not None and state.delivered == len(state.place_indices):
                kinds = tuple(
                    (subtask.box, subtask.action.kind, subtask.action.has_chains)
                    for subtask in task_plan.subtasks
                )
                actions = tuple((subtask.box, subtask.action) for subtask in task_plan.subtasks)
                if (
                    num_of_kind[kinds] < MAX_PLANS_PER_KIND
                    and num_of_actions[actions] < MAX_PLANS_PER_ACTIONS
                ):
                    num_of_kind[kinds] += 1
                    num_of_actions[actions] += 1
                    yield task_plan
                continue
            visit = (state, task_plan.subtasks[-1].action if task_plan else None)
            visits[visit] += 1
            num_expanded[state.place_indices] += 1
            if visits[visit] > 1 or num_expanded[state.place_indices] > MAX_PLANS_PER_KIND:
                continue
            for successor, extended in self._expand(state, task_plan):
                bound = extended.cost() + SUBTASK_COST * self._estimate_cost_to_go(successor)
                heapq.heappush(queue, (bound, next(tie_breaker), successor, extended))

    def _estimate_cost_to_go(self, state: TaskState) -> int:
        """Return a lower bound on the number of subtasks from a state to the goals.

        A box at the goal of an earlier one has to stand somewhere else in the meantime.
        """
        total = 0
        for box, (cost_to_go, index) in enumerate(
            zip(self.cost_to_go, state.place_indices, strict=True)
        ):
            remaining = int(cost_to_go[index])
            earlier = range(state.delivered, box)
            if remaining < 2 and any(
                self.space.overlaps_goal(box, index, earlier_box) for earlier_box in earlier
            ):
                remaining = 2
            total += remaining
        return total

    def _expand(
        self, state: TaskState, task_plan: TaskPlan | None
    ) -> Iterator[tuple[TaskState, TaskPlan]]:
        """Yield the best successor states of one more subtask, with the extended task plans."""
        subtasks = () if task_plan is None else task_plan.subtasks
        detour_before = max(
            len(subtasks) + self._estimate_cost_to_go(state) - self.fewest_simple_subtasks, 0
        )
        for box in range(state.delivered, len(state.place_indices)):
            places, index = self.space.boxes[box].places, state.place_indices[box]
            for relaxed in self.space.find_actions(box, state):
                action = relaxed.action
                repeats_action = (
                    bool(subtasks) and subtasks[-1].box == box and subtasks[-1].action == action
                )
                effect = self.space.compute_latch_effect(state, action)
                if effect is None or (repeats_action and action.kind == "quadruped"):
                    continue
                for target in self._select_places(relaxed, box, state, len(subtasks)):
                    successor = TaskState(
                        (*state.place_indices[:box], target, *state.place_indices[box + 1 :]),
                        effect.latched,
                    )
                    subtask = Subtask(
                        action,
                        freeze_placement(places[index]),
                        freeze_placement(places[target]),
                        box,
                        is_set_aside=target != GOAL,
                    )
                    distance = float(path_length(places[index], places[target]))
                    secondary_cost = _SECONDARY_COST_WEIGHT * (
                        0.1 * action.num_modules
                        + 0.2 * distance
                        + _LATCH_CHANGE_COST * effect.num_moves
                    )
                    detour = max(
                        len(subtasks)
                        + 1
                        + self._estimate_cost_to_go(successor)
                        - self.fewest_simple_subtasks,
                        0,
                    )
                    secondary_cost += _DETOUR_COST * (detour - detour_before) + (
                        task_plan.secondary_cost if task_plan else 0.0
                    )
                    yield successor, TaskPlan((*subtasks, subtask), secondary_cost)

    def _select_places(
        self, relaxed: RelaxedAction, box: int, state: TaskState, num_subtasks: int
    ) -> Iterator[int]:
        """Yield places to bring a box to: its goal alone if it can go there.

        Args:
            relaxed: The action and the places it relates.
            box: The box to move.
            state: The state before the action.
            num_subtasks: Number of subtasks before the action.
        """
        index, box_places = state.place_indices[box], self.space.boxes[box]
        is_successor = relaxed.find_successors(index)
        is_next = box == state.delivered
        places = state.place_indices
        at_goal = state._replace(place_indices=(*places[:box], GOAL, *places[box + 1 :]))
        cost_of_others = self._estimate_cost_to_go(at_goal)
        if (
            is_successor[GOAL]
            and is_next
            and num_subtasks + cost_of_others + 1 >= self.min_subtasks
        ):
            yield GOAL
            return
        clearance = self.space.compute_clearances(box, state)
        is_successor = is_successor & (clearance > 0)
        is_successor[[START, GOAL, index]] = False
        chosen: dict[int, None] = {}
        for heuristic in box_places.heuristics:
            candidates = np.flatnonzero(
                is_successor & (num_subtasks + 1 + heuristic + cost_of_others <= self.max_subtasks)
            )
            order = np.lexsort(
                (
                    self._distance_to_middle(box_places.places, index)[candidates],
                    -clearance[candidates],
                    heuristic[candidates],
                )
            )
            chosen |= dict.fromkeys(
                int(candidate) for candidate in candidates[order[:_MAX_SUCCESSORS]]
            )
        yield from chosen

    @staticmethod
    def _distance_to_middle(places: Array, index: int) -> Array:
        """Return how far places (n,) are from midway to the goal, where space is widest [m]."""
        middle = (places[index] + places[GOAL])[:2] / 2
        distance: Array = np.linalg.norm(places[:, :2] - middle, axis=1)
        return distance
