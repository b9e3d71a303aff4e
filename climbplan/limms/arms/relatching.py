"""One module holds the box, lets go of the ground, and comes to an anchor of the wall from there.

The box stands meanwhile: on a stable box a module stands as on the ground, one end latched to a
side and the other on nothing. So it comes to anchors that are out of its reach from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.arms.held_branches import branch_choices
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import arm, limb_angles, root_on_anchor, side_pose
from climbplan.limms.motion.assembly import latch_box, latch_from_ground, reach_box
from climbplan.limms.motion.between_legs import Settle, as_it_is, come_down
from climbplan.limms.motion.densify import add_traces
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import reach
from climbplan.limms.motion.straight_ways import leave
from climbplan.limms.motion.stretch_clearance import require_clear_of_all
from climbplan.limms.motion.timeline import (
    ARM,
    DRIVES,
    MANIPULATED,
    NOWHERE,
    STABLE,
    PartialPlan,
    samples,
)
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, is_on_ground
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb


def relatch(
    world: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    settle: Settle = as_it_is,
) -> PartialPlan | None:
    """The world after a module came to its anchor over the box and carried it, or None."""
    scene, connection = world.scene, action.connections[0]
    task = delivery(scene, budget)
    if task is None:
        return None
    name = action.describe(scene)
    for module in _owners(scene, connection):
        budget.begin(f"{name}: module {scene.module_names[module]} to the box")
        try:
            held = on_box(world, module, connection.side, action.releases_ground_anchor, rng)
        except Blocked as error:
            budget.notes.append(f"{name}: {error}")
            continue
        box_end = 0 if held.base_anchor[module] == connection.side else 1
        root = root_on_anchor(scene, connection.root, 1 - box_end)
        limb = arm(module, connection.side, root, box_end)
        for arms, outcome in solved_branches(scene, [limb], task, name, budget):
            with noted(budget, name):
                return settle(_from_box(held, arms[0], connection, outcome, rng))
    return None


def _owners(scene: Scene, connection: Connection) -> Iterator[int]:
    """Modules, those nearest to the side of the box first."""
    place = side_pose(scene, scene.start_placement, connection.side, 0).position
    ranked = []
    for module in range(scene.num_modules):
        anchor = int(scene.start_anchor[module]) - scene.wall_offset
        now = scene.start_position[module] if anchor < 0 else scene.wall_position[anchor]
        ranked.append((float(np.linalg.norm(now - place)), module))
    for _, module in sorted(ranked)[:2]:
        yield module


def on_box(
    world: PartialPlan, module: int, side: int, lets_go: bool, rng: np.random.Generator
) -> PartialPlan:
    """Everything until a module is held by a side of the standing box alone.

    lets_go: a module on an anchor of the ground drives first, otherwise it comes from there. One
    that hangs on a wall comes from there, or else down and then from the ground.

    Raises:
        Blocked: no free way was found.
    """
    scene = world.scene
    name, anchor = scene.module_names[module], int(scene.start_anchor[module])
    if anchor >= 0 and not lets_go:
        try:
            return _from_anchor(world, module, side, rng)
        except Blocked:
            if world.tip_anchor[module] != anchor:
                raise
            world = come_down(world, module, rng)
    elif anchor >= 0 and not is_on_ground(scene, anchor - scene.wall_offset):
        raise Blocked(f"{name} is latched to a wall and cannot drive")
    target = side_pose(scene, world.place, side, 1)
    return latch_from_ground(world, module, target, side, DRIVES, name, rng)


def _from_anchor(
    world: PartialPlan, module: int, side: int, rng: np.random.Generator
) -> PartialPlan:
    """The same for a module that is latched to the terrain, and lets go once it has the box."""
    scene = world.scene
    name, anchor = scene.module_names[module], int(scene.start_anchor[module])
    end = 0 if world.base_anchor[module] == anchor else 1  # that is latched to the terrain
    root = root_on_anchor(scene, anchor - scene.wall_offset, end)
    limb = arm(module, side, root, 1 - end)
    here = world.place[None]
    reason = Blocked(f"{name}: the box is out of reach from where it is latched")
    for _, _, choice in branch_choices(scene, limb, here, root.position[None]):
        angles, _ = limb_angles(scene, choice, here, root.position[None], choice.branch)
        attempt = world.copy()
        try:
            reach_box(attempt, choice, attempt.place, angles[:1], f"{name}: to the box", rng)
            latch_box(attempt, [choice])
            hold(attempt, choice, f"{name}: latch")
            attempt.box_mode = STABLE
            attempt.mode[module] = DRIVES
            (attempt.base_anchor, attempt.tip_anchor)[end][module] = NOWHERE
            held = side_pose(scene, attempt.place, side, 1 - end)
            leave(attempt, module, held, 1 - end, f"{name}: let go")
        except Blocked as error:
            reason = error
            continue
        return attempt
    raise reason


def hold(world: PartialPlan, limb: Limb, name: str) -> None:
    """Rest for as long as a latch takes to close, the arm holding the box where it stands."""
    scene = world.scene
    world.box_mode = MANIPULATED
    waiting = world.rest(name, samples(max(scene.module.latch_dwell, 0.05)))
    waiting.force[:, limb.side, 2] = scene.weight
    world.add(waiting)


def _from_box(
    world: PartialPlan,
    limb: Limb,
    connection: Connection,
    outcome: ProgramOutcome,
    rng: np.random.Generator,
) -> PartialPlan:
    """From the box to the wall, and on with the box.

    Raises:
        Blocked: a way there is not free, or the carried motion touches something.
    """
    scene, module = world.scene, limb.module
    world = world.copy()
    name = f"{scene.module_names[module]}: to the wall"
    root = side_pose(scene, world.place, limb.side, limb.box_end)
    target = root_on_anchor(scene, connection.root, 1 - limb.box_end)
    reach(world, module, root, limb.box_end, target, outcome.traces[0].angles[0, 0], name, rng)
    anchors = world.tip_anchor if limb.box_end == 0 else world.base_anchor
    anchors[module] = scene.wall_offset + connection.root
    world.mode[module] = ARM
    hold(world, limb, f"{scene.module_names[module]}: latch")
    before = len(world.stretches)
    add_traces(world, [limb], outcome.traces)
    for stretch in world.stretches[before:]:
        require_clear_of_all(scene, stretch)
    return world
