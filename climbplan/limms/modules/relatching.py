"""One module holds the box, lets go of the ground, and comes to an anchor of the wall from there.

The box stands meanwhile: on a stable box a module stands as on the ground, one end latched to a
side and the other on nothing. So it comes to anchors that are out of its reach from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.limms.arms.answers import Outcome
from climbplan.limms.arms.branches import delivery, noted, solved_branches
from climbplan.limms.arms.held_branches import branch_choices
from climbplan.limms.assembly import (
    initial,
    latch_box,
    latch_from_ground,
    reach_box,
)
from climbplan.limms.attempts import Attempts
from climbplan.limms.bounds import Connection, on_ground
from climbplan.limms.densify import add_traces
from climbplan.limms.modules.limbs import arm, limb_angles, root_on_anchor, side_pose
from climbplan.limms.modules.moving import Blocked
from climbplan.limms.modules.reaching import reach
from climbplan.limms.modules.straight_ways import leave
from climbplan.limms.modules.stretch_clearance import require_clear_of_all
from climbplan.limms.scene import Scene
from climbplan.limms.sequences import Sequence as Modes
from climbplan.limms.statement import Limb
from climbplan.limms.timeline import ARM, DRIVES, MANIPULATED, NOWHERE, STABLE, PlanSoFar, samples


def relatch(
    scene: Scene, modes: Modes, attempts: Attempts, rng: np.random.Generator
) -> PlanSoFar | None:
    """A plan in which a module comes to its anchor over the box and then carries it, or None."""
    connection = modes.connections[0]
    task = delivery(scene, attempts)
    if task is None:
        return None
    for module in _owners(scene, connection):
        attempts.begin(f"{modes.named(scene)}: module {scene.module_names[module]} to the box")
        try:
            world = on_box(scene, module, connection.side, modes.lets_go, rng)
        except Blocked as error:
            attempts.notes.append(f"{modes.named(scene)}: {error}")
            continue
        box_end = 0 if world.base_anchor[module] == connection.side else 1
        root = root_on_anchor(scene, connection.root, 1 - box_end)
        limb = arm(module, connection.side, root, box_end)
        name = modes.named(scene)
        for arms, outcome in solved_branches(scene, [limb], task, name, attempts):
            with noted(attempts, name):
                return _from_box(world, arms[0], connection, outcome, rng)
    return None


def _owners(scene: Scene, connection: Connection) -> Iterator[int]:
    """Modules, those nearest to the side of the box first."""
    place = side_pose(scene, scene.start_place, connection.side, 0).position
    ranked = []
    for module in range(scene.count):
        anchor = int(scene.held[module]) - scene.wall_offset
        now = scene.stand[module] if anchor < 0 else scene.wall_position[anchor]
        ranked.append((float(np.linalg.norm(now - place)), module))
    for _, module in sorted(ranked)[:2]:
        yield module


def on_box(
    scene: Scene, module: int, side: int, lets_go: bool, rng: np.random.Generator
) -> PlanSoFar:
    """Everything until a module is held by a side of the standing box alone.

    lets_go: a module on an anchor of the ground drives first, otherwise it comes from there.

    Raises:
        Blocked: no free way was found.
    """
    world = initial(scene)
    if scene.held[module] >= 0 and not lets_go:
        return _from_anchor(world, module, side, rng)
    if scene.held[module] >= 0 and not on_ground(
        scene, int(scene.held[module]) - scene.wall_offset
    ):
        raise Blocked(f"{scene.module_names[module]} is latched to a wall and cannot drive")
    target = side_pose(scene, world.place, side, 1)
    name = scene.module_names[module]
    return latch_from_ground(world, module, target, side, DRIVES, name, rng)


def _from_anchor(world: PlanSoFar, module: int, side: int, rng: np.random.Generator) -> PlanSoFar:
    """The same for a module that is latched to the terrain, and lets go once it has the box."""
    scene = world.scene
    name = scene.module_names[module]
    root = root_on_anchor(scene, int(scene.held[module]) - scene.wall_offset, 0)
    limb = arm(module, side, root, 1)
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
            attempt.base_anchor[module] = NOWHERE
            leave(attempt, module, side_pose(scene, attempt.place, side, 1), 1, f"{name}: let go")
        except Blocked as error:
            reason = error
            continue
        return attempt
    raise reason


def hold(world: PlanSoFar, limb: Limb, name: str) -> None:
    """Rest for as long as a latch takes to close, the arm holding the box where it stands."""
    scene = world.scene
    world.box_mode = MANIPULATED
    waiting = world.rest(name, samples(max(scene.module.latch_dwell, 0.05)))
    waiting.force[:, limb.side, 2] = scene.weight
    world.add(waiting)


def _from_box(
    world: PlanSoFar,
    limb: Limb,
    connection: Connection,
    outcome: Outcome,
    rng: np.random.Generator,
) -> PlanSoFar:
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
