"""A mode sequence with arms made into a plan: who, which branches, program, way there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from climbplan.limms.arms.answers import Outcome
from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.assembly import initial, latch_arm, latch_box, reach_box
from climbplan.limms.attempts import Attempts
from climbplan.limms.bounds import Connection, standing_places
from climbplan.limms.densify import add_traces
from climbplan.limms.modules.limbs import arm, root_on_anchor
from climbplan.limms.modules.stretch_clearance import require_clear_of_all
from climbplan.limms.scene import Scene
from climbplan.limms.sequences import Sequence as Modes
from climbplan.limms.statement import Limb
from climbplan.limms.timeline import PlanSoFar


def carry(
    scene: Scene,
    modes: Modes,
    attempts: Attempts,
    rng: np.random.Generator,
    given: tuple[int, ...] | None = None,
) -> PlanSoFar | None:
    """A plan in which arms carry or throw the box, or None; given: the arms' modules."""
    task = delivery(scene, attempts, modes.kind == "throw", scene.arrival_speed)
    if task is None:
        return None
    for owners in _owners(scene, modes.connections) if given is None else (given,):
        limbs = [
            limb_of(scene, module, connection)
            for module, connection in zip(owners, modes.connections, strict=True)
        ]
        name = modes.named(scene)
        for chosen, outcome in solved_branches(scene, limbs, task, name, attempts):
            with noted(attempts, name):
                return whole_carried(scene, chosen, modes.connections, outcome, rng)
    return None


def _owners(scene: Scene, connections: Sequence[Connection]) -> Iterator[tuple[int, ...]]:
    """Which modules, the nearest first; a module latched to an anchor is the one that uses it."""
    n = len(connections)
    costs = []
    places = standing_places(scene)
    for modules in permutations(range(scene.count), n):
        cost = 0.0
        for module, connection in zip(modules, connections, strict=True):
            anchor = scene.wall_offset + connection.root
            if scene.held[module] == anchor:
                continue
            if anchor in scene.held:
                cost += np.inf
            else:
                away = places[module] - scene.wall_position[connection.root]
                cost += float(np.linalg.norm(away))
        if np.isfinite(cost):
            costs.append((cost, modules))
    costs.sort()
    for _, modules in costs[:1]:
        yield modules


def limb_of(scene: Scene, module: int, connection: Connection) -> Limb:
    """The arm of a module from an anchor of the terrain to a side of the box."""
    latched = scene.held[module] == scene.wall_offset + connection.root
    box_end = 1 if latched else 0
    root = root_on_anchor(scene, connection.root, 1 - box_end)
    return arm(module, connection.side, root, box_end)


def whole_carried(
    scene: Scene,
    limbs: Sequence[Limb],
    connections: Sequence[Connection],
    outcome: Outcome,
    rng: np.random.Generator,
) -> PlanSoFar:
    """Everything from the modules' start to the goal.

    Raises:
        Blocked: a way there is not free, or the carried motion touches something.
    """
    world = initial(scene)
    for limb, connection in zip(limbs, connections, strict=True):
        name = scene.module_names[limb.module]
        world, _ = latch_arm(world, limb.module, connection.root, name, rng)
    for i, limb in enumerate(limbs):
        name = f"{scene.module_names[limb.module]}: to the box"
        path = np.concatenate([trace.angles[:, i] for trace in outcome.traces])
        reach_box(world, limb, outcome.traces[0].position[0], path, name, rng)
    latch_box(world, limbs)
    before = len(world.stretches)
    add_traces(world, limbs, outcome.traces)
    for stretch in world.stretches[before:]:
        require_clear_of_all(scene, stretch)
    return world
