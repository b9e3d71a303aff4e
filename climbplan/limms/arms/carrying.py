"""Arms carry or throw the box from where it stands: who, which branches, program, way there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import arm, root_on_anchor
from climbplan.limms.motion.assembly import latch_arm, latch_box, reach_box
from climbplan.limms.motion.between_legs import Settle, as_it_is, come_down
from climbplan.limms.motion.densify import add_traces
from climbplan.limms.motion.stretch_clearance import require_clear_of_all
from climbplan.limms.motion.timeline import NOWHERE, PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, is_on_ground
from climbplan.limms.scene.phases import Limb

_DOWN = 2.0  # [m] that coming down from a wall counts as, beside driving
_OWNERS = 2  # choices of modules


def carry(
    world: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    given: tuple[int, ...] | None = None,
    settle: Settle = as_it_is,
) -> PartialPlan | None:
    """The world after arms carried or threw the box, or None; given: the arms' modules."""
    scene = world.scene
    task = delivery(scene, budget, action.kind == "throw", scene.arrival_speed)
    if task is None:
        return None
    name = action.describe(scene)
    for owners in _owners(world, action.connections) if given is None else (given,):
        limbs = [
            limb_of(world, module, connection)
            for module, connection in zip(owners, action.connections, strict=True)
        ]
        is_solved = False
        for chosen, outcome in solved_branches(scene, limbs, task, name, budget):
            is_solved = True
            with noted(budget, name):
                return settle(whole_carried(world, chosen, action.connections, outcome, rng))
        if not is_solved:
            return None  # nor would other modules, as they are alike
    return None


def _owners(world: PartialPlan, connections: Sequence[Connection]) -> Iterator[tuple[int, ...]]:
    """Which modules, those with the least way first; who is latched to an anchor is its arm."""
    scene = world.scene
    taken = set(world.base_anchor) | set(world.tip_anchor)
    ranked = []
    for modules in permutations(range(scene.num_modules), len(connections)):
        cost = 0.0
        for module, connection in zip(modules, connections, strict=True):
            anchor = scene.wall_offset + connection.root
            ends = {int(world.base_anchor[module]), int(world.tip_anchor[module])}
            if anchor in ends:
                continue
            away = world.base_position[module] - scene.wall_position[connection.root]
            cost += float(np.linalg.norm(away)) + (0.0 if _drives(world, ends) else _DOWN)
            if anchor in taken:
                cost = np.inf
        if np.isfinite(cost):
            ranked.append((cost, modules))
    for _, modules in sorted(ranked)[:_OWNERS]:
        yield modules


def _drives(world: PartialPlan, ends: set[int]) -> bool:
    """Whether a module with these anchors at its ends drives, or stands on one that it leaves."""
    offset, anchors = world.scene.wall_offset, len(world.scene.anchor_names)
    return all(
        end == NOWHERE or (offset <= end < anchors and is_on_ground(world.scene, end - offset))
        for end in ends
    )


def limb_of(world: PartialPlan, module: int, connection: Connection) -> Limb:
    """The arm of a module from an anchor of the terrain to a side of the box."""
    scene = world.scene
    latched = world.base_anchor[module] == scene.wall_offset + connection.root
    box_end = 1 if latched else 0
    root = root_on_anchor(scene, connection.root, 1 - box_end)
    return arm(module, connection.side, root, box_end)


def whole_carried(
    world: PartialPlan,
    limbs: Sequence[Limb],
    connections: Sequence[Connection],
    outcome: ProgramOutcome,
    rng: np.random.Generator,
) -> PartialPlan:
    """Everything from where the modules are until the box is where it is to be.

    Raises:
        Blocked: a way there is not free, or the carried motion touches something.
    """
    scene, world = world.scene, world.copy()
    for limb, connection in zip(limbs, connections, strict=True):
        name = scene.module_names[limb.module]
        ends = world.base_anchor[limb.module], world.tip_anchor[limb.module]
        if scene.wall_offset + connection.root not in ends:
            world = come_down(world, limb.module, rng)
        world, _ = latch_arm(world, limb.module, connection.root, name, rng)
    return brought(world, limbs, outcome, rng)


def brought(
    world: PartialPlan, limbs: Sequence[Limb], outcome: ProgramOutcome, rng: np.random.Generator
) -> PartialPlan:
    """Arms on their anchors come to the box, latch to it at once, and bring it on.

    Raises:
        Blocked: a way there is not free, or the carried motion touches something.
    """
    scene, world = world.scene, world.copy()
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
