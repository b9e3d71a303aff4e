"""Between two legs of a course: the box is put down, and the next leg begins where everything is.

Every manoeuvre begins from a world that is `headed`: its scene starts where box and modules are now
and ends where the leg is to bring the box. So none of them knows what went before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.motion.assembly import root_pose
from climbplan.limms.motion.climbing_down import climb_down
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.straight_ways import leave
from climbplan.limms.motion.timeline import DRIVES, LEG, NOWHERE, STABLE, PartialPlan
from climbplan.limms.scene.bounds import is_on_ground
from climbplan.limms.scene.limms_scene import Scene, put_box_first
from climbplan.limms.scene.placement import centre_of, yaw_of

Settle = Callable[[PartialPlan], PartialPlan]
"""What follows a leg, at once: raises `Blocked` where that does not do, so that the leg goes on."""


def as_it_is(world: PartialPlan) -> PartialPlan:
    """Nothing follows."""
    return world


def headed(world: PartialPlan, end: Array, speed: float = 0.0) -> PartialPlan:
    """The world in a scene that begins where everything is, and ends with the box at `end`.

    end: (D,) placement of the box [m, rad]; speed: at which it may arrive [m/s]. Modules on walls
    keep the places where they last stood.
    """
    scene, moved = world.scene, world.copy()
    starts, yaws, goals = scene.box_start.copy(), scene.start_yaws.copy(), scene.goal_yaws.copy()
    starts[0], yaws[0], goals[0] = world.box, world.yaw, float(yaw_of(end))
    anchors = np.stack([world.base_anchor, world.tip_anchor])
    on_terrain = (anchors >= scene.wall_offset) & (anchors < len(scene.anchor_names))
    moved.scene = replace(
        scene,
        box_start=starts,
        start_yaws=yaws,
        goal=centre_of(end),
        goal_yaws=goals,
        arrival_speed=speed,
        start_anchor=np.where(on_terrain, anchors, NOWHERE).max(axis=0),
        start_position=np.where(
            (world.grounded == 0)[:, None], world.base_position, scene.start_position
        ),
    )
    return moved


def turned_to(world: PartialPlan, box: int, base: Scene) -> PartialPlan:
    """The world with another box to bring next, the one that it brought put down.

    box: its number in the plan, and in `base`, which has boxes in that order.
    """
    if world.scene.box_number[0] == box:
        return world
    places = np.empty((base.num_boxes, 4))
    places[list(world.scene.box_number)] = np.column_stack([world.centres, world.yaws])
    goal = np.array([*base.goals[box], base.goal_yaws[box]])
    turned = world.copy()
    turned.scene = replace(
        put_box_first(base, box, places, goal, 0.0),
        start_anchor=world.scene.start_anchor,
        start_position=world.scene.start_position,
    )
    turned.box, turned.yaw, turned.box_mode = places[box, :3].copy(), float(places[box, 3]), STABLE
    return turned


def put_down(world: PartialPlan) -> PartialPlan:
    """The box stands at the goal of the world's scene; all modules let go of it and draw back.

    Legs of the box stand up straight then, so that they can drive and are out of the way.

    Raises:
        Blocked: a module cannot draw back.
    """
    world, scene, rng = world.copy(), world.scene, np.random.default_rng(0)
    goal = scene.goal_placement
    world.box, world.yaw, world.box_mode = centre_of(goal), float(yaw_of(goal)), STABLE
    ends = np.stack([world.base_anchor, world.tip_anchor])  # (2, L)
    holding = [(int(end), int(module)) for end, module in np.argwhere((ends >= 0) & (ends < 4))]
    legs = [(end, module) for end, module in holding if world.mode[module] == LEG]
    for end, module in holding:
        (world.base_anchor, world.tip_anchor)[end][module] = NOWHERE
        if (end, module) in legs:
            world.mode[module], world.grounded[module] = DRIVES, 1 - end
    for end, module in holding:
        name = f"{scene.module_names[module]}: let go"
        leave(world, module, root_pose(world, module, 1 - end), 1 - end, name)
    for end, module in legs:
        name = f"{scene.module_names[module]}: stand up"
        root = root_pose(world, module, 1 - end)
        move_joints(world, module, root, 1 - end, np.zeros(6), name, rng)
    return world


def come_down(world: PartialPlan, module: int, rng: np.random.Generator) -> PartialPlan:
    """As the world is, but a module that hangs on the terrain by its last end stands and drives.

    Raises:
        Blocked: it holds on to a wall by its first end, or to another module, or finds no way.
    """
    scene, base = world.scene, int(world.base_anchor[module]) - world.scene.wall_offset
    if world.tip_anchor[module] == NOWHERE and (base < 0 or is_on_ground(scene, base)):
        return world
    if world.tip_anchor[module] >= len(scene.anchor_names):
        raise Blocked(f"{scene.module_names[module]}: it hangs on another module")
    return climb_down(world, module, rng)
