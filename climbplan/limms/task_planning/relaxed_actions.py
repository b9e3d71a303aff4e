"""Relaxed actions: between which places each action may bring the box, by necessary conditions.

These relations replace the preconditions and effects of an action in the task search. They are
necessary conditions, but for two caps: chains are cut to a dozen sets, and throws end at most 0.3 m
beyond reach. An arm holds the box where inverse kinematics is feasible within joint ranges
and free of collision. A throw starts at such a place and ends at the goal. A module relatches where
it reaches the box first, and from over the box its anchor. Chains must reach the box when stretched
out and bear its load. Legs walk from ground to ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import (
    Connection,
    anchor_wrist,
    check_holding,
    is_accessible,
    is_accessible_over_box,
    joint_distance,
    max_chain_span,
    side_wrist,
)
from climbplan.limms.scene.corridor import decompose_free_space, list_standing_yaws
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.placement import swept_half_extents, yaw_of
from climbplan.limms.task_planning.reachability import (
    HoldingCache,
    find_holding_places,
    is_within_span,
)
from climbplan.limms.task_planning.single_actions import EASY_FLIGHT, check_quadruped

GRID_SPACING = 0.12  # [m] of the grid of places
_MAX_CHAIN_SETS = 12  # sets of chains, those that reach the box from most places


@dataclass(frozen=True)
class RelaxedAction:
    """An action and the places it relates: each row maps its start places to its end places."""

    action: Action
    begin: BoolArray  # (rows, n), the box may start at place
    end: BoolArray  # (rows, n), the box may end at place

    def find_successors(self, index: int) -> BoolArray:
        """Return the places that the action may bring the box to from a place, bool (n,)."""
        return np.asarray(self.end[self.begin[:, index]].any(axis=0))

    def find_predecessors(self, targets: BoolArray) -> BoolArray:
        """Return the places from which the action may reach any of the targets, both bool (n,)."""
        return np.asarray(self.begin[(self.end & targets).any(axis=1)].any(axis=0))


def list_places(scene: ModuleScene) -> Array:
    """Return start, goal, and all places where the box can be put down (n, D) [m, rad]."""
    return np.vstack([scene.start_placement, scene.goal_placement, list_standing_places(scene)])


def list_standing_places(scene: ModuleScene) -> Array:
    """Return placements of the box (n, D) on a grid, its whole base on the ground [m, rad]."""
    blocks = decompose_free_space(scene)
    places_by_yaw = [
        _list_places_at_yaw(scene, blocks, float(yaw) if scene.uses_yaw else None)
        for yaw in list_standing_yaws(scene)
    ]
    return np.concatenate(places_by_yaw)


def _list_places_at_yaw(scene: ModuleScene, blocks: Array, yaw: float | None) -> Array:
    """Return standing placements (n, D) at one yaw; None leaves out the yaw coordinate."""
    half = swept_half_extents(scene.box_size[0] / 2, yaw or 0.0, yaw or 0.0)
    grid_points: set[tuple[float, float, float]] = set()
    for patch in scene.patches:
        spans = [
            np.arange(np.ceil((low + h) / GRID_SPACING), np.floor((high - h) / GRID_SPACING) + 1)
            * GRID_SPACING
            for low, high, h in zip(patch.lower, patch.upper, half[:2], strict=True)
        ]
        for x in spans[0]:
            height = patch.height + half[2]
            grid_points |= {(float(x), float(y), float(height)) for y in spans[1]}
    places = np.array(sorted(grid_points)).reshape(-1, 3)
    if yaw is not None:
        places = np.column_stack([places, np.full(len(places), yaw)])
    is_above = places[:, None] >= blocks[:, 0] - 1e-9
    is_inside = (is_above & (places[:, None] <= blocks[:, 1] + 1e-9)).all(axis=2)
    distance = np.abs(places[:, None, :2] - scene.start_position[None, :, :2])
    is_apart = np.any(distance > half[:2] + scene.module.radius, axis=2)
    is_unoccupied = np.all(is_apart | np.any(np.isnan(scene.start_position), axis=1), axis=1)
    standing: Array = places[np.any(is_inside, axis=1) & is_unoccupied]
    return standing


def find_first_end_anchors(partial_plan: PartialPlan) -> frozenset[int]:
    """Return the terrain anchors, numbered among those, that hold first ends of modules."""
    offset, anchors = partial_plan.scene.wall_offset, len(partial_plan.scene.anchor_names)
    return frozenset(int(a) - offset for a in partial_plan.base_anchor if offset <= a < anchors)


def relax_carrying(
    scene: ModuleScene, places: Array, first_end_anchors: frozenset[int], cache: HoldingCache
) -> list[RelaxedAction]:
    """Return the carrying actions of single arms if one latch holds the box, else of pairs."""
    if "arms" not in scene.allow:
        return []
    return [
        RelaxedAction(Action("arms", arms), mask, mask)
        for arms, mask in _find_holding_arms(scene, places, first_end_anchors, cache)
        if mask.any()
    ]


def relax_actions(
    scene: ModuleScene, places: Array, first_end_anchors: frozenset[int], cache: HoldingCache
) -> list[RelaxedAction]:
    """Return all actions that may move the first box of the scene.

    Args:
        scene: The scene with all other boxes where they stand.
        places: Placements of the box (n, D) [m, rad]: start, goal, standing places.
        first_end_anchors: Terrain anchors that hold first ends of modules.
        cache: Holding maps of the same box and places with fewer other boxes; missing ones are
            added.
    """
    carrying = relax_carrying(scene, places, first_end_anchors, cache)
    relaxed = carrying + list(_relax_throws(scene, carrying, places))
    if "arms" in scene.allow:
        relaxed += [*_relax_relatching(scene, places, cache), *_relax_chains(scene, places)]
    return relaxed + list(_relax_walking(scene, places))


def compute_cost_to_go(
    relaxed_actions: Sequence[RelaxedAction], goal: int, num_places: int
) -> IntArray:
    """Return the fewest subtasks (n,) from every place to a goal by backward breadth-first search.

    No task plan over the same places has fewer: the result is an admissible heuristic.

    Args:
        relaxed_actions: The relations between places.
        goal: Index of the goal place.
        num_places: Number of places n; also the value where no action leads to the goal.
    """
    cost_to_go = np.full(num_places, num_places)
    cost_to_go[goal] = 0
    for num_subtasks in range(1, num_places):
        is_layer = cost_to_go == num_subtasks - 1
        if not is_layer.any():
            break
        for relaxed in relaxed_actions:
            is_predecessor = relaxed.find_predecessors(is_layer)
            cost_to_go[is_predecessor] = np.minimum(cost_to_go[is_predecessor], num_subtasks)
    return cost_to_go


def _find_holding_arms(
    scene: ModuleScene, places: Array, first_end_anchors: frozenset[int], cache: HoldingCache
) -> list[tuple[tuple[Connection, ...], BoolArray]]:
    """Return sets of arms that hold the box, and where they can, bool (branches, places)."""
    single: list[tuple[Connection, BoolArray]] = []
    for root in range(scene.num_wall_anchors):
        if is_accessible(scene, root):
            single += [
                (c, find_holding_places(scene, c, places, root in first_end_anchors, cache))
                for c in (Connection(root, side) for side in range(4))
            ]
    singles: list[tuple[tuple[Connection, ...], BoolArray]] = [
        ((connection,), mask)
        for connection, mask in single
        if not check_holding(scene, (connection,))
    ]
    if singles or scene.num_modules < 2:
        return singles
    return [
        ((first, second), np.atleast_2d(a.any(axis=0) & b.any(axis=0)))
        for (first, a), (second, b) in combinations(single, 2)
        if first.root != second.root
        and first.side != second.side
        and not check_holding(scene, (first, second))
    ]


def _mark_goal(like: BoolArray) -> BoolArray:
    """Return a mask of the same shape that allows the goal alone as the end."""
    end = np.zeros_like(like)
    end[:, 1] = True
    return end


def _relax_throws(
    scene: ModuleScene, carrying: Sequence[RelaxedAction], places: Array
) -> Iterator[RelaxedAction]:
    """Yield throws to the goal by arms that do not hold the box there, but nearly do."""
    if "flight" not in scene.allow or scene.arrival_speed <= 0:
        return
    reach = max_chain_span(scene, 1) + EASY_FLIGHT
    for relaxed in carrying:
        arms = relaxed.action.connections
        if not relaxed.end[:, 1].any() and all(
            joint_distance(anchor_wrist(scene, c.root), side_wrist(scene, c.side, places[1]))
            <= reach
            for c in arms
        ):
            yield RelaxedAction(Action("throw", arms), relaxed.begin, _mark_goal(relaxed.begin))


def _relax_relatching(
    scene: ModuleScene, places: Array, cache: HoldingCache
) -> Iterator[RelaxedAction]:
    """Yield relatching of one module over the box to anchors out of reach from the ground."""
    for root, side in product(range(scene.num_wall_anchors), range(4)):
        connection = Connection(root, side)
        if is_accessible(scene, root) or check_holding(scene, (connection,)):
            continue
        is_holdable = np.vstack(
            [find_holding_places(scene, connection, places, end, cache) for end in (True, False)]
        )
        if is_holdable.any():
            is_over = np.array(
                [is_accessible_over_box(scene, connection, place) for place in places]
            )
            yield RelaxedAction(
                Action("relatch", (connection,)), is_holdable & is_over, is_holdable
            )


def _relax_chains(scene: ModuleScene, places: Array) -> list[RelaxedAction]:
    """Return chains of arms that bring the box to its goal: one if it holds the box, else two."""
    single = [
        Connection(root, side, links)
        for root in range(scene.num_wall_anchors)
        if is_accessible(scene, root)
        for side in range(4)
        for links in range(1, min(scene.num_modules, 2) + 1)
    ]
    is_reached = {c: is_within_span(scene, c, places) for c in single}
    single = [c for c in single if is_reached[c][1]]
    sets: list[tuple[Connection, ...]] = [(c,) for c in single if not check_holding(scene, (c,))]
    if not sets:
        sets = [
            (first, second)
            for first, second in combinations(single, 2)
            if first.root != second.root
            and first.side != second.side
            and not check_holding(scene, (first, second))
        ]
    relaxed = []
    for arms in sets:
        if sum(c.links for c in arms) <= scene.num_modules and any(c.links > 1 for c in arms):
            begin = np.all([is_reached[c] for c in arms], axis=0)[None]
            relaxed.append(RelaxedAction(Action("arms", arms), begin, _mark_goal(begin)))
    relaxed.sort(key=lambda action: -int(action.begin.sum()))
    return relaxed[:_MAX_CHAIN_SETS]


def _relax_walking(scene: ModuleScene, places: Array) -> Iterator[RelaxedAction]:
    """Yield the walk on four legs, to the ground or the goal, for a box at yaw zero."""
    if "quadruped" not in scene.allow or check_quadruped(scene):
        return
    is_untwisted = np.abs(yaw_of(places)) < 1e-12
    if is_untwisted[0]:
        end_mask = is_untwisted[None]
        begin = end_mask.copy()
        begin[:, 1] = False
        yield RelaxedAction(Action("quadruped"), begin, end_mask)
