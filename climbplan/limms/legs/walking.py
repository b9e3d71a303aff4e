"""The box as body of a quadruped, from where it stands: footholds, gait, program, assembly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.legs.gaits import gaits
from climbplan.limms.legs.motion import leg_motion
from climbplan.limms.legs.quadruped import solve_sound, starts
from climbplan.limms.legs.statement import LegEnds, LegTrace
from climbplan.limms.legs.stretches import add_leg_traces
from climbplan.limms.motion.assembly import latch_box, stand_leg
from climbplan.limms.motion.between_legs import Settle, as_it_is, come_down, headed
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb


def walk(
    world: PartialPlan,
    budget: SearchBudget,
    most_steps: int,
    rng: np.random.Generator,
    only: str = "",
    settle: Settle = as_it_is,
) -> PartialPlan | None:
    """The world after four modules were legs of the box, or None.

    only: name of the gait to try, all if empty. Modules on walls come down first.

    Raises:
        LimitReached: budget or time of the whole planning are over.
    """
    try:
        world = _all_down(world, rng)
    except Blocked as error:
        budget.notes.append(f"quadruped: {error}")
        return None
    scene = world.scene
    way = find_corridor(decompose_free_space(scene), scene.box_start[0], scene.goal)
    if way is None:
        budget.notes.append("there is no way for the box")
        return None
    ends = LegEnds(scene.box_start[0], scene.goal)
    reach = sum(scene.module.link_lengths[:5])  # the last link but one stands upright
    shift = scene.goal - scene.box_start[0]
    for gait in gaits(4, len(way.blocks), shift, reach, most_steps):
        if only and gait.name != only:
            continue
        count = 0
        for start in starts(scene, gait, way, rng, budget.deadline):
            count += 1
            budget.begin(f"quadruped, {gait.name}")
            outcome = solve_sound(scene, start, ends, budget.deadline)
            budget.record(outcome, f"quadruped, {gait.name}")
            if not outcome.solved:
                continue
            try:
                return settle(_whole(world, start.limbs, outcome.traces, budget, rng))
            except Blocked as error:
                budget.notes.append(f"quadruped, {gait.name}: {error}")
        budget.require_remaining()
        if not count:
            budget.notes.append(f"quadruped, {gait.name}: no pose of the legs serves it")
    return None


def _all_down(world: PartialPlan, rng: np.random.Generator) -> PartialPlan:
    """As the world is, but modules that hang on walls by their last ends drive, as legs need them.

    Raises:
        Blocked: a module does not come down.
    """
    scene = world.scene
    for module in np.flatnonzero(world.tip_anchor >= 0):
        if (world.scene.start_anchor < 0).sum() >= 4:
            break
        down = come_down(world, int(module), rng)
        world = headed(down, scene.goal_placement, scene.arrival_speed)
    return world


def _whole(
    before: PartialPlan,
    limbs: Sequence[Limb],
    traces: Sequence[LegTrace],
    budget: SearchBudget,
    rng: np.random.Generator,
) -> PartialPlan:
    """Modules drive up, latch at once, and the box moves.

    Raises:
        Blocked: a way to the box is not free.
        LimitReached: budget or time of the whole planning are over.
    """
    scene, feet = before.scene, traces[0].before
    angles = leg_motion(scene, limbs, traces[0]).angles[0]
    reason: Exception | None = None
    for owners in _owners(scene, feet):
        owned = [replace(limb, module=m) for limb, m in zip(limbs, owners, strict=True)]
        for order in _orders(len(limbs)):
            budget.require_remaining()
            world = before.copy()
            try:
                for i in order:
                    stand_leg(world, owned[i], feet[i], angles[i], rng)
            except Blocked as error:
                reason = error
                continue
            latch_box(world, owned)
            add_leg_traces(world, owned, traces)
            return world
    raise Blocked(str(reason) if reason else "no module stands on the ground of the footholds")


def _orders(n: int) -> Iterator[tuple[int, ...]]:
    yield tuple(range(n))
    yield tuple(reversed(range(n)))


def _owners(scene: Scene, feet: Array) -> Iterator[tuple[int, ...]]:
    """Which module goes to which foothold: least distance, on the same level of ground."""
    free = [m for m in range(scene.num_modules) if scene.start_anchor[m] < 0]
    ranked = []
    for modules in permutations(free, len(feet)):
        away = scene.start_position[list(modules)] - feet
        if np.abs(away[:, 2]).max() > 1e-6:
            continue
        ranked.append((float(np.linalg.norm(away, axis=1).sum()), modules))
    ranked.sort()
    for _, modules in ranked[:3]:
        yield modules
