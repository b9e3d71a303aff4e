"""A mode sequence with arms on arms made into a plan: carriers, added arms, program, way there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from climbplan.limms.arms.added import Grip, grips, grounds, pairs
from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.arms.held_branches import HeldTask, way_points
from climbplan.limms.assembly import (
    initial,
    latch_arm,
    latch_box,
    latch_from_ground,
    reach_box,
    root_pose,
)
from climbplan.limms.attempts import Attempts
from climbplan.limms.bounds import Connection, standing_places
from climbplan.limms.densify import add_traces
from climbplan.limms.modules.limbs import arm
from climbplan.limms.modules.moving import Blocked
from climbplan.limms.modules.reaching import move_joints
from climbplan.limms.modules.stretch_clearance import require_clear_of_all
from climbplan.limms.scene import Array, Scene
from climbplan.limms.sequences import Sequence as Modes
from climbplan.limms.statement import Limb, Trace
from climbplan.limms.timeline import ADDED_ARM, PlanSoFar


@dataclass(frozen=True)
class Chain:
    """One connection with its modules; the second, if there is one, is the added arm."""

    connection: Connection
    modules: tuple[int, ...]


def carry_on_chains(
    scene: Scene,
    modes: Modes,
    attempts: Attempts,
    rng: np.random.Generator,
    given: tuple[Chain, ...] | None = None,
) -> PlanSoFar | None:
    """A plan in which chains of modules carry the box, or None; given: their modules."""
    task = delivery(scene, attempts)
    if task is None:
        return None
    for chains in _owners(scene, modes.connections) if given is None else (given,):
        attempts.begin(f"{modes.named(scene)}: arms come to their anchors")
        try:
            world, still = _carriers(scene, chains, task, rng)
        except Blocked as error:
            attempts.notes.append(f"{modes.named(scene)}: {error}")
            continue
        for chosen in pairs(still):
            try:
                ready, limbs = _added(world, chains, chosen, rng)
            except Blocked as error:
                attempts.notes.append(f"{modes.named(scene)}: {error}")
                continue
            name = modes.named(scene)
            for arms, outcome in solved_branches(scene, limbs, task, name, attempts):
                with noted(attempts, name):
                    return _whole(ready, arms, outcome.traces, rng)
    return None


def _owners(scene: Scene, connections: Sequence[Connection]) -> Iterator[tuple[Chain, ...]]:
    """Which modules, least way to their anchors; who is latched to an anchor starts its chain."""
    needed = sum(c.links for c in connections)
    best: tuple[float, tuple[int, ...]] | None = None
    places = standing_places(scene)
    for modules in permutations(range(scene.count), needed):
        cost, taken = 0.0, 0
        for connection in connections:
            anchor = scene.wall_offset + connection.root
            for place in range(connection.links):
                module = modules[taken + place]
                held = int(scene.held[module])
                if (held == anchor) != (place == 0 and anchor in scene.held):
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
    scene: Scene, chains: Sequence[Chain], task: HeldTask, rng: np.random.Generator
) -> tuple[PlanSoFar, list[list[Grip]]]:
    """First modules of all chains latched to their anchors; where their free ends may be held.

    Raises:
        Blocked: a module does not get to its anchor, or no place for an added arm is good.
    """
    world = initial(scene)
    for chain in chains:
        name = scene.module_names[chain.modules[0]]
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
    world: PlanSoFar, chains: Sequence[Chain], chosen: Sequence[Grip], rng: np.random.Generator
) -> tuple[PlanSoFar, list[Limb]]:
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


def _whole(
    world: PlanSoFar, limbs: Sequence[Limb], traces: Sequence[Trace], rng: np.random.Generator
) -> PlanSoFar:
    """Raises Blocked where a way to the box is not free, or the motion touches something."""
    scene, world = world.scene, world.copy()
    for i, limb in enumerate(limbs):
        name = f"{scene.module_names[limb.module]}: to the box"
        path = np.concatenate([trace.angles[:, i] for trace in traces])
        reach_box(world, limb, traces[0].position[0], path, name, rng)
    latch_box(world, limbs)
    before = len(world.stretches)
    add_traces(world, limbs, traces)
    for stretch in world.stretches[before:]:
        require_clear_of_all(scene, stretch)
    return world
