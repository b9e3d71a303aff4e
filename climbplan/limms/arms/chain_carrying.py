"""Arms on arms carry the box from where it stands: carriers, added arms, program, way there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.added import Grip, grips, grounds, pairs
from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.arms.carrying import brought
from climbplan.limms.arms.held_branches import HeldTask, way_points
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import arm
from climbplan.limms.motion.assembly import latch_arm, latch_from_ground, root_pose
from climbplan.limms.motion.between_legs import Settle, as_it_is, come_down
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.timeline import ADDED_ARM, PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, find_module_stands
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb


@dataclass(frozen=True)
class Chain:
    """One connection with its modules; the second, if there is one, is the added arm."""

    connection: Connection
    modules: tuple[int, ...]


def carry_on_chains(
    world: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    given: tuple[Chain, ...] | None = None,
    settle: Settle = as_it_is,
) -> PartialPlan | None:
    """The world after chains of modules carried the box, or None; given: their modules."""
    scene = world.scene
    task = delivery(scene, budget)
    if task is None:
        return None
    name = action.describe(scene)
    for chains in _owners(scene, action.connections) if given is None else (given,):
        budget.begin(f"{name}: arms come to their anchors")
        try:
            hanging, still = _carriers(world, chains, task, rng)
        except Blocked as error:
            budget.notes.append(f"{name}: {error}")
            continue
        for chosen in pairs(still):
            try:
                ready, limbs = _added(hanging, chains, chosen, rng)
            except Blocked as error:
                budget.notes.append(f"{name}: {error}")
                continue
            for arms, outcome in solved_branches(scene, limbs, task, name, budget):
                with noted(budget, name):
                    return settle(brought(ready, arms, outcome, rng))
    return None


def _owners(scene: Scene, connections: Sequence[Connection]) -> Iterator[tuple[Chain, ...]]:
    """Which modules, least way to their anchors; who is latched to an anchor starts its chain."""
    needed = sum(c.links for c in connections)
    best: tuple[float, tuple[int, ...]] | None = None
    places = find_module_stands(scene)
    for modules in permutations(range(scene.num_modules), needed):
        cost, taken = 0.0, 0
        for connection in connections:
            anchor = scene.wall_offset + connection.root
            for place in range(connection.links):
                module = modules[taken + place]
                held = int(scene.start_anchor[module])
                if (held == anchor) != (place == 0 and anchor in scene.start_anchor):
                    cost = np.inf
                elif held != anchor:
                    away = places[module] - scene.wall_position[connection.root]
                    cost += float(np.linalg.norm(away)) * (1.0 if place else 1.001)
            taken += connection.links
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = (cost, modules)
    if best is None:
        return
    chains, taken = [], 0
    for connection in connections:
        chains.append(Chain(connection, best[1][taken : taken + connection.links]))
        taken += connection.links
    yield tuple(chains)


def _carriers(
    world: PartialPlan, chains: Sequence[Chain], task: HeldTask, rng: np.random.Generator
) -> tuple[PartialPlan, list[list[Grip]]]:
    """First modules of all chains latched to their anchors; where their free ends may be held.

    Raises:
        Blocked: a module does not get to its anchor, or no place for an added arm is good.
    """
    scene = world.scene
    for chain in chains:
        name = scene.module_names[chain.modules[0]]
        for number, module in enumerate(chain.modules):
            anchor = scene.wall_offset + chain.connection.root
            if number or anchor not in (world.base_anchor[module], world.tip_anchor[module]):
                world = come_down(world, module, rng)
        world, _ = latch_arm(world, chain.modules[0], chain.connection.root, name, rng)
    path = _path(task)
    still = []
    for chain in chains:
        carrier = chain.modules[0]
        if chain.connection.links == 1:
            end = 0 if world.base_anchor[carrier] >= 0 else 1
            still.append([Grip(root_pose(world, carrier, end), world.angles[carrier], 0.0)])
            continue
        found = grips(world, carrier, chain.connection.side, path, grounds(scene))
        if not found:
            name = scene.module_names[carrier]
            raise Blocked(f"module {name} holds no place from which another serves the way")
        still.append(found)
    return world, still


def _path(task: HeldTask) -> Array:
    corners = way_points(task)
    share = np.linspace(0, 1, 9)[:, None]
    return np.vstack([first + share * (last - first) for first, last in pairwise(corners)])


def _added(
    world: PartialPlan, chains: Sequence[Chain], chosen: Sequence[Grip], rng: np.random.Generator
) -> tuple[PartialPlan, list[Limb]]:
    """Carriers hold their ends where they are to be, and added arms come to them.

    Raises:
        Blocked: no free way was found.
    """
    scene = world.scene
    world = world.copy()
    for chain, grip in zip(chains, chosen, strict=True):
        if chain.connection.links > 1:
            carrier = chain.modules[0]
            wall_end = 0 if world.base_anchor[carrier] >= 0 else 1
            root = root_pose(world, carrier, wall_end)
            name = f"{scene.module_names[carrier]}: hold out"
            move_joints(world, carrier, root, wall_end, grip.carrier, name, rng)
    limbs = []
    for chain, grip in zip(chains, chosen, strict=True):
        carrier, last = chain.modules[0], chain.modules[-1]
        wall_end = 0 if world.base_anchor[carrier] >= 0 else 1
        box_end = 1 - wall_end
        if chain.connection.links > 1:
            anchor = scene.end_anchor(carrier, 1 - wall_end)
            name = f"{scene.module_names[last]} onto {scene.module_names[carrier]}"
            world = latch_from_ground(world, last, grip.root, anchor, ADDED_ARM, name, rng)
            box_end = 0
        limbs.append(arm(last, chain.connection.side, grip.root, box_end))
    return world, limbs
