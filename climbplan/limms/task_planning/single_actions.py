"""Actions that bring the box to its goal at once: what the logic rules allow, cheapest first.

Modules are identical, so a configuration says how many hold the box from where, not which ones:
symmetric permutations count once. Necessary conditions prune actions before any program is solved:
force at latches and feet, moment at latches, reach, access to the anchors, and the number of
modules.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import comb, floor, perm

from climbplan.errors import Conflict, Remedy
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import (
    Connection,
    anchor_wrist,
    check_holding,
    compute_ground_end_frame,
    is_accessible,
    is_accessible_over_box,
    is_within_reach,
    joint_distance,
    max_chain_span,
    side_wrist,
)
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene

MAX_CHAIN_LENGTH = 2  # modules in a chain, at most
EASY_FLIGHT = 0.3  # [m] beyond the reach of arms: throws over this distance are easy


@dataclass(frozen=True)
class CandidateActions:
    """Actions to try, cheapest first, and why the others are impossible."""

    actions: tuple[Action, ...]
    conflicts: tuple[Conflict, ...]
    configurations: int  # number of sets of connections, up to permuting modules


def find_single_actions(scene: ModuleScene) -> CandidateActions:
    """Return the actions that pass the necessary conditions, and the conflicts of the others."""
    conflicts: list[Conflict] = []
    actions: list[Action] = []
    num_configurations = 0
    if (
        find_corridor(decompose_free_space(scene), scene.start_placement, scene.goal_placement)
        is None
    ):
        reason = "free space holds no way for the box from its start to its goal"
        return CandidateActions(
            (),
            (
                Conflict(
                    "box", (reason,), (Remedy("another box.size"), Remedy("another box.goal")), True
                ),
            ),
            0,
        )
    if "arms" in scene.allow:
        arm_sets = list(_enumerate_arm_sets(scene))
        num_configurations += _count_configurations(scene)
        actions += _filter_arm_sets(scene, arm_sets, num_configurations, conflicts)
    else:
        conflicts.append(Conflict("arms", ("not among task.allow",), (), True))
    num_configurations += 1
    if "quadruped" not in scene.allow:
        conflicts.append(Conflict("quadruped", ("not among task.allow",), (), True))
    else:
        actions += _filter_quadruped(scene, conflicts)
    actions.sort(key=Action.cost)
    return CandidateActions(tuple(actions), tuple(conflicts), num_configurations)


def _enumerate_arm_sets(scene: ModuleScene) -> Iterator[tuple[Connection, ...]]:
    """Yield sets of chains that reach the box: different anchors and sides, enough modules."""
    start = scene.start_placement
    reachable = [
        [
            connection
            for links in range(1, min(MAX_CHAIN_LENGTH, scene.num_modules) + 1)
            for side in range(4)
            for connection in (Connection(root, side, links),)
            if is_within_reach(scene, (connection,), start)
        ]
        for root in range(scene.num_wall_anchors)
    ]
    for num_chains in range(1, min(scene.num_modules, scene.num_wall_anchors, 4) + 1):
        for roots in combinations(range(scene.num_wall_anchors), num_chains):
            for connections in product(*(reachable[root] for root in roots)):
                sides = {connection.side for connection in connections}
                if (
                    len(sides) == num_chains
                    and sum(c.links for c in connections) <= scene.num_modules
                ):
                    yield connections


def _count_configurations(scene: ModuleScene) -> int:
    """Return how many sets of chains there are, within reach or not."""
    return sum(
        comb(scene.num_wall_anchors, n) * perm(4, n)
        for n in range(1, min(scene.num_modules, scene.num_wall_anchors, 4) + 1)
        for links in product(range(1, MAX_CHAIN_LENGTH + 1), repeat=n)
        if sum(links) <= scene.num_modules
    )


def _filter_arm_sets(
    scene: ModuleScene,
    arm_sets: list[tuple[Connection, ...]],
    num_sets: int,
    conflicts: list[Conflict],
) -> list[Action]:
    """Return the arm actions that pass all conditions, and append the conflicts of the others.

    Args:
        arm_sets: Sets of chains that reach the box at its start.
        num_sets: Number of all sets of chains.
        conflicts: Appended to where no arm action is left.
    """
    if not num_sets:
        conflicts.append(Conflict("arms", ("there is no anchor to hold on to",), (), True))
        return []
    num_arms = min(scene.num_modules, scene.num_wall_anchors, 4)
    strength = num_arms * scene.module.max_force
    if strength < scene.weight:
        # From rest to rest forces carry the weight on average, with or without a flight.
        shortfall = scene.weight - strength
        what = (
            f"{num_arms} arms hold {strength:.1f} N at most, the box weighs {scene.weight:.1f} N: "
            f"{shortfall:.1f} N short"
        )
        heaviest = floor(1e2 * strength / GRAVITY) / 1e2
        remedies = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),)
        conflicts.append(Conflict("arms", (what,), remedies, True))
        return []
    actions: list[Action] = []
    num_by_reason = dict.fromkeys(("force", "moment", "reach", "way to the anchor"), 0)
    num_by_reason["reach"] = num_sets - len(arm_sets)
    for connections in arm_sets:
        arm_actions = _list_arm_actions(scene, connections)
        if isinstance(arm_actions, str):
            num_by_reason[arm_actions] += 1
        else:
            actions += arm_actions
    if not actions:
        counted = ", ".join(f"{n} by {cause}" for cause, n in num_by_reason.items() if n)
        what = f"each of {num_sets} ways to hold the box is ruled out ({counted})"
        conflicts.append(Conflict("arms", (what,), (), True))
    return actions


def _list_arm_actions(
    scene: ModuleScene, connections: tuple[Connection, ...]
) -> list[Action] | str:
    """Return what chains can do with the box, or the name of the condition that excludes them."""
    allow_throw = "flight" in scene.allow and scene.arrival_speed > 0
    reason = check_holding(scene, connections)
    if reason:
        return reason
    is_goal_reached = is_within_reach(scene, connections, scene.goal_placement)
    if not is_goal_reached and not allow_throw:
        return "reach"
    wrist_distance = _sum_wrist_distances(scene, connections)
    is_single = all(c.links == 1 for c in connections)
    actions = []
    if all(is_accessible(scene, c.root) for c in connections):
        if is_goal_reached:
            actions.append(Action("arms", connections, wrist_distance))
        if allow_throw and is_single:
            actions.append(
                Action(
                    "throw", connections, wrist_distance, _compute_extra_flight(scene, connections)
                )
            )
    allow_relatch = len(connections) == 1 and is_single and is_goal_reached
    if allow_relatch and is_accessible_over_box(scene, connections[0], scene.start_placement):
        actions.append(Action("relatch", connections, wrist_distance))
        if any(
            a >= 0 and compute_ground_end_frame(scene, int(a) - scene.wall_offset)
            for a in scene.start_anchor
        ):
            actions.append(
                Action("relatch", connections, wrist_distance, releases_ground_anchor=True)
            )
    return actions or "way to the anchor"


def _sum_wrist_distances(scene: ModuleScene, connections: tuple[Connection, ...]) -> float:
    """Return the distances between wrists at anchors and box, summed over start and goal [m]."""
    return sum(
        joint_distance(anchor_wrist(scene, c.root), side_wrist(scene, c.side, box))
        for c in connections
        for box in (scene.start_placement, scene.goal_placement)
    )


def _compute_extra_flight(scene: ModuleScene, connections: tuple[Connection, ...]) -> float:
    """Return how far the goal lies beyond the arms' reach and `EASY_FLIGHT` [m]."""
    beyond = max(
        joint_distance(anchor_wrist(scene, c.root), side_wrist(scene, c.side, scene.goal_placement))
        - max_chain_span(scene, c.links)
        for c in connections
    )
    return max(beyond - EASY_FLIGHT, 0.0)


def _filter_quadruped(scene: ModuleScene, conflicts: list[Conflict]) -> list[Action]:
    """Return the quadruped action if it is possible, else append the conflict."""
    if scene.uses_yaw:
        reason = "legs do not turn a box, nor stand beside one that is turned"
        conflicts.append(Conflict("quadruped", (reason,), (), True))
        return []
    conflicts_found = check_quadruped(scene)
    conflicts += conflicts_found
    return [] if conflicts_found else [Action("quadruped")]


def check_quadruped(scene: ModuleScene) -> tuple[Conflict, ...]:
    """Return why four modules cannot be legs of the box wherever it stands; empty if they can."""
    strength = 4 * scene.module.max_force
    if scene.num_modules < 4:
        reason = f"it takes 4 modules, there are {scene.num_modules}"
        return (Conflict("quadruped", (reason,), (), True),)
    if strength < scene.weight:
        reason = (
            f"4 legs push {strength:.1f} N at most, the box weighs {scene.weight:.1f} N: "
            f"{scene.weight - strength:.1f} N short"
        )
        heaviest = floor(1e2 * strength / GRAVITY) / 1e2
        remedies = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),)
        return (Conflict("quadruped", (reason,), remedies, True),)
    return ()
