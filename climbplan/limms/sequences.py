"""Search over mode sequences: configurations that the logic rules allow, cheapest first.

Modules are alike, so a configuration says how many hold the box from where, not which (their
permutations are one). Bounds that no plan escapes cut sequences off before any program is solved:
force at latches and feet, moment at latches, reach, number of modules.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from climbplan.errors import Conflict
from climbplan.limms.scene import SIDES, Scene
from climbplan.limms.statement import held_forces


@dataclass(frozen=True)
class Connection:
    """An arm from an anchor of the terrain to a side of the box."""

    root: int  # number of the anchor among those of the terrain
    side: int


@dataclass(frozen=True)
class Sequence:
    """How the box moves from start to goal: held by arms, thrown by them, or as a quadruped."""

    kind: str  # "arms", "throw", "quadruped"
    connections: tuple[Connection, ...] = ()

    @property
    def modules(self) -> int:
        """How many modules it takes."""
        return 4 if self.kind == "quadruped" else len(self.connections)

    def cost(self) -> float:
        """What is tried first: few modules, no flight."""
        return self.modules + (0.5 if self.kind == "throw" else 0.0)

    def named(self, scene: Scene) -> str:
        """In words."""
        if self.kind == "quadruped":
            return "quadruped"
        names = scene.anchor_names[scene.wall_offset :]
        arms = ", ".join(f"{names[c.root]} to {SIDES[c.side]}" for c in self.connections)
        return f"{self.kind}: {arms}"


@dataclass(frozen=True)
class Search:
    """Sequences to try, cheapest first; why others cannot be; how many there were."""

    sequences: tuple[Sequence, ...]
    conflicts: tuple[Conflict, ...]
    configurations: int  # of connections, up to permuting modules


def search(scene: Scene) -> Search:
    """All mode sequences that pass the bounds."""
    conflicts: list[Conflict] = []
    found: list[Sequence] = []
    count = 0
    if "arms" in scene.allow:
        every = list(_arm_sets(scene))
        count += len(every)
        found += _possible_arms(scene, every, conflicts)
    else:
        conflicts.append(Conflict("arms", ("not among task.allow",), (), True))
    count += 1
    if "quadruped" not in scene.allow:
        conflicts.append(Conflict("quadruped", ("not among task.allow",), (), True))
    else:
        found += _possible_quadruped(scene, conflicts)
    found.sort(key=Sequence.cost)
    return Search(tuple(found), tuple(conflicts), count)


def _arm_sets(scene: Scene) -> Iterator[tuple[Connection, ...]]:
    """Sets of arms: different anchors, different sides, as many modules as there are."""
    for n in range(1, min(scene.count, scene.walls, 4) + 1):
        for roots in combinations(range(scene.walls), n):
            for sides in permutations(range(4), n):
                yield tuple(Connection(r, s) for r, s in zip(roots, sides, strict=True))


def _possible_arms(
    scene: Scene, every: list[tuple[Connection, ...]], conflicts: list[Conflict]
) -> list[Sequence]:
    if not every:
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
        cures = (f"box.mass <= {strength / 9.81:.2f} kg",)
        conflicts.append(Conflict("arms", (what,), cures, True))
        return []
    found = []
    reasons = {"force": 0, "moment": 0, "reach": 0}
    thrown = "flight" in scene.allow and scene.arrival_speed > 0
    for connections in every:
        reason = _misfit(scene, connections, scene.box_start[0])
        if reason:
            reasons[reason] += 1
            continue
        if _misfit(scene, connections, scene.goal) != "reach":
            found.append(Sequence("arms", connections))
        elif not thrown:
            reasons["reach"] += 1
        if thrown:
            found.append(Sequence("throw", connections))
    if not found:
        counted = ", ".join(f"{n} by {reason}" for reason, n in reasons.items() if n)
        what = f"each of {len(every)} ways to hold the box is ruled out ({counted})"
        conflicts.append(Conflict("arms", (what,), (), True))
    return found


def _misfit(scene: Scene, connections: tuple[Connection, ...], box: np.ndarray) -> str:
    """Which bound rules arms out with the box at rest there; empty if none."""
    offsets = np.array([scene.side_offset(0, c.side) for c in connections])
    share = held_forces(offsets, scene.module.max_force, scene.module.latch_moment)
    both = share @ np.array([0, 0, scene.weight])
    n = len(connections)
    force = np.linalg.norm(both[: 3 * n].reshape(n, 3), axis=1).max()
    moment = np.linalg.norm(both[3 * n :].reshape(n, 3), axis=1).max()
    if force > scene.module.max_force:
        return "force"
    if moment > scene.module.latch_moment:
        return "moment"
    a = scene.module.link_lengths
    stretch, ends = sum(a[2:5]), (a[0] + a[1], a[5] + a[6])
    for connection, offset in zip(connections, offsets, strict=True):
        shoulder = (
            scene.wall_position[connection.root] + ends[0] * scene.wall_normal[connection.root]
        )
        wrist = box + offset + ends[1] * offset / np.linalg.norm(offset)
        if np.linalg.norm(wrist - shoulder) > stretch:
            return "reach"
    return ""


def _possible_quadruped(scene: Scene, conflicts: list[Conflict]) -> list[Sequence]:
    strength = 4 * scene.module.max_force
    if scene.count < 4:
        what = f"it takes 4 modules, there are {scene.count}"
        conflicts.append(Conflict("quadruped", (what,), (), True))
        return []
    if strength < scene.weight:
        what = (
            f"4 legs push {strength:.1f} N at most, the box weighs {scene.weight:.1f} N: "
            f"{scene.weight - strength:.1f} N short"
        )
        cures = (f"box.mass <= {strength / 9.81:.2f} kg",)
        conflicts.append(Conflict("quadruped", (what,), cures, True))
        return []
    return [Sequence("quadruped")]
