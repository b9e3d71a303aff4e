"""Actions that bring the box to its goal at once: what the logic rules allow, cheapest first.

Modules are alike, so a configuration says how many hold the box from where, not which (their
permutations are one). Bounds that no plan escapes cut actions off before any program is solved:
force at latches and feet, moment at latches, reach, ways to the anchors, number of modules.
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
    access,
    access_over_box,
    anchor_wrist,
    chain_stretch,
    holding_misfit,
    on_ground,
    side_wrist,
    span,
    within_reach,
)
from climbplan.limms.scene.corridor import centre_blocks, ways
from climbplan.limms.scene.limms_scene import GRAVITY, Scene

LONGEST = 2  # modules in a chain
FLIGHT = 0.3  # [m] beyond the reach of arms: what throws do easily


@dataclass(frozen=True)
class Search:
    """Actions to try, cheapest first; why others cannot be; how many there were."""

    actions: tuple[Action, ...]
    conflicts: tuple[Conflict, ...]
    configurations: int  # of connections, up to permuting modules


def search(scene: Scene) -> Search:
    """All actions that pass the bounds."""
    conflicts: list[Conflict] = []
    found: list[Action] = []
    count = 0
    if ways(centre_blocks(scene), scene.start_place, scene.goal_place) is None:
        what = "free space holds no way for the box from its start to its goal"
        return Search(
            (),
            (
                Conflict(
                    "box", (what,), (Remedy("another box.size"), Remedy("another box.goal")), True
                ),
            ),
            0,
        )
    if "arms" in scene.allow:
        every = list(_arm_sets(scene))
        count += _configurations(scene)
        found += _possible_arms(scene, every, count, conflicts)
    else:
        conflicts.append(Conflict("arms", ("not among task.allow",), (), True))
    count += 1
    if "quadruped" not in scene.allow:
        conflicts.append(Conflict("quadruped", ("not among task.allow",), (), True))
    else:
        found += _possible_quadruped(scene, conflicts)
    found.sort(key=Action.cost)
    return Search(tuple(found), tuple(conflicts), count)


def _arm_sets(scene: Scene) -> Iterator[tuple[Connection, ...]]:
    """Sets of chains that reach the box: different anchors, different sides, enough modules."""
    start = scene.start_place
    near = [
        [
            connection
            for links in range(1, min(LONGEST, scene.count) + 1)
            for side in range(4)
            for connection in (Connection(root, side, links),)
            if within_reach(scene, (connection,), start)
        ]
        for root in range(scene.walls)
    ]
    for n in range(1, min(scene.count, scene.walls, 4) + 1):
        for roots in combinations(range(scene.walls), n):
            for connections in product(*(near[root] for root in roots)):
                sides = {connection.side for connection in connections}
                if len(sides) == n and sum(c.links for c in connections) <= scene.count:
                    yield connections


def _configurations(scene: Scene) -> int:
    """How many sets of chains there are, near or far."""
    return sum(
        comb(scene.walls, n) * perm(4, n)
        for n in range(1, min(scene.count, scene.walls, 4) + 1)
        for links in product(range(1, LONGEST + 1), repeat=n)
        if sum(links) <= scene.count
    )


def _possible_arms(
    scene: Scene, every: list[tuple[Connection, ...]], count: int, conflicts: list[Conflict]
) -> list[Action]:
    """count: of all sets of chains; `every`: those that reach the box at its start."""
    if not count:
        conflicts.append(Conflict("arms", ("there is no anchor to hold on to",), (), True))
        return []
    most = min(scene.count, scene.walls, 4)
    strength = most * scene.module.max_force
    if strength < scene.weight:
        # From rest to rest forces carry the weight on average, with or without a flight.
        short = scene.weight - strength
        what = (
            f"{most} arms hold {strength:.1f} N at most, the box weighs {scene.weight:.1f} N: "
            f"{short:.1f} N short"
        )
        heaviest = floor(1e2 * strength / GRAVITY) / 1e2
        cures = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),)
        conflicts.append(Conflict("arms", (what,), cures, True))
        return []
    found: list[Action] = []
    reasons = dict.fromkeys(("force", "moment", "reach", "way to the anchor"), 0)
    reasons["reach"] = count - len(every)
    for connections in every:
        possible = _uses(scene, connections)
        if isinstance(possible, str):
            reasons[possible] += 1
        else:
            found += possible
    if not found:
        counted = ", ".join(f"{n} by {reason}" for reason, n in reasons.items() if n)
        what = f"each of {count} ways to hold the box is ruled out ({counted})"
        conflicts.append(Conflict("arms", (what,), (), True))
    return found


def _uses(scene: Scene, connections: tuple[Connection, ...]) -> list[Action] | str:
    """What chains can do with the box, or what rules them out."""
    thrown = "flight" in scene.allow and scene.arrival_speed > 0
    reason = holding_misfit(scene, connections)
    if reason:
        return reason
    carried = within_reach(scene, connections, scene.goal_place)
    if not carried and not thrown:
        return "reach"
    away = _away(scene, connections)
    single = all(c.links == 1 for c in connections)
    found = []
    if all(access(scene, c.root) for c in connections):
        if carried:
            found.append(Action("arms", connections, away))
        if thrown and single:
            found.append(Action("throw", connections, away, _flight(scene, connections)))
    relatched = len(connections) == 1 and single and carried
    if relatched and access_over_box(scene, connections[0], scene.start_place):
        found.append(Action("relatch", connections, away))
        if any(a >= 0 and on_ground(scene, int(a) - scene.wall_offset) for a in scene.held):
            found.append(Action("relatch", connections, away, lets_go=True))
    return found or "way to the anchor"


def _away(scene: Scene, connections: tuple[Connection, ...]) -> float:
    """Distances between the wrists at anchors and box, at start and goal together [m]."""
    return sum(
        span(anchor_wrist(scene, c.root), side_wrist(scene, c.side, box))
        for c in connections
        for box in (scene.start_place, scene.goal_place)
    )


def _flight(scene: Scene, connections: tuple[Connection, ...]) -> float:
    """How much further beyond the reach of arms their goal is than `FLIGHT` [m]."""
    beyond = max(
        span(anchor_wrist(scene, c.root), side_wrist(scene, c.side, scene.goal_place))
        - chain_stretch(scene, c.links)
        for c in connections
    )
    return max(beyond - FLIGHT, 0.0)


def _possible_quadruped(scene: Scene, conflicts: list[Conflict]) -> list[Action]:
    if scene.turns:
        what = "legs do not turn a box, nor stand beside one that is turned"
        conflicts.append(Conflict("quadruped", (what,), (), True))
        return []
    misfit = legs_misfit(scene)
    conflicts += misfit
    return [] if misfit else [Action("quadruped")]


def legs_misfit(scene: Scene) -> tuple[Conflict, ...]:
    """Why modules cannot be legs of the box wherever it stands."""
    strength = 4 * scene.module.max_force
    if scene.count < 4:
        what = f"it takes 4 modules, there are {scene.count}"
        return (Conflict("quadruped", (what,), (), True),)
    if strength < scene.weight:
        what = (
            f"4 legs push {strength:.1f} N at most, the box weighs {scene.weight:.1f} N: "
            f"{scene.weight - strength:.1f} N short"
        )
        heaviest = floor(1e2 * strength / GRAVITY) / 1e2
        cures = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),)
        return (Conflict("quadruped", (what,), cures, True),)
    return ()
