"""Between two subtasks of a task plan: modules release the box, and the next subtask starts.

Every manoeuvre starts from a retargeted plan: its scene starts with the current state and ends
where the subtask brings the box. So no manoeuvre depends on earlier ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.motion.assembly import compute_end_pose
from climbplan.limms.motion.climbing_down import climb_down
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.straight_motion import retract
from climbplan.limms.motion.timeline import DRIVES, LEG, NOWHERE, STABLE, PartialPlan
from climbplan.limms.scene.bounds import compute_ground_end_frame
from climbplan.limms.scene.limms_scene import ModuleScene, put_box_first
from climbplan.limms.scene.placement import centre_of, yaw_of

Settle = Callable[[PartialPlan], PartialPlan]
"""Follows a subtask at once; raises `Blocked` if it fails, so that the subtask is retried."""


def keep_plan(partial_plan: PartialPlan) -> PartialPlan:
    """Return the plan unchanged."""
    return partial_plan


def retarget(partial_plan: PartialPlan, end: Array, speed: float = 0.0) -> PartialPlan:
    """Return the plan in a scene that starts with the current state and ends with the box at `end`.

    Args:
        partial_plan: Where everything is. Modules on walls keep the positions where they last
            stood.
        end: Placement of the box (D,) [m, rad].
        speed: Speed at which it may arrive [m/s].
    """
    scene, retargeted = partial_plan.scene, partial_plan.copy()
    starts, yaws, goals = scene.box_start.copy(), scene.start_yaws.copy(), scene.goal_yaws.copy()
    starts[0], yaws[0], goals[0] = partial_plan.box, partial_plan.yaw, float(yaw_of(end))
    anchors = np.stack([partial_plan.base_anchor, partial_plan.tip_anchor])
    on_terrain = (anchors >= scene.wall_offset) & (anchors < len(scene.anchor_names))
    retargeted.scene = replace(
        scene,
        box_start=starts,
        start_yaws=yaws,
        goal=centre_of(end),
        goal_yaws=goals,
        arrival_speed=speed,
        start_anchor=np.where(on_terrain, anchors, NOWHERE).max(axis=0),
        start_position=np.where(
            (partial_plan.grounded == 0)[:, None], partial_plan.base_position, scene.start_position
        ),
    )
    return retargeted


def switch_box(partial_plan: PartialPlan, box: int, base: ModuleScene) -> PartialPlan:
    """Return the plan with another box to bring next, the last one put down.

    Args:
        partial_plan: Where everything is.
        box: Number of the box in the plan, and in `base`.
        base: The scene with boxes in the order of the plan.
    """
    if partial_plan.scene.box_number[0] == box:
        return partial_plan
    places = np.empty((base.num_boxes, 4))
    places[list(partial_plan.scene.box_number)] = np.column_stack(
        [partial_plan.centres, partial_plan.yaws]
    )
    goal = np.array([*base.goals[box], base.goal_yaws[box]])
    switched = partial_plan.copy()
    switched.scene = replace(
        put_box_first(base, box, places, goal, 0.0),
        start_anchor=partial_plan.scene.start_anchor,
        start_position=partial_plan.scene.start_position,
    )
    switched.box, switched.yaw, switched.box_mode = (
        places[box, :3].copy(),
        float(places[box, 3]),
        STABLE,
    )
    return switched


def release_box(partial_plan: PartialPlan) -> PartialPlan:
    """Put the box down at the goal of the scene; all modules release it and draw back.

    Legs of the box then stand up straight, so that they can drive and are out of the way.

    Raises:
        Blocked: A module cannot draw back.
    """
    partial_plan, scene, rng = partial_plan.copy(), partial_plan.scene, np.random.default_rng(0)
    goal = scene.goal_placement
    partial_plan.box, partial_plan.yaw, partial_plan.box_mode = (
        centre_of(goal),
        float(yaw_of(goal)),
        STABLE,
    )
    ends = np.stack([partial_plan.base_anchor, partial_plan.tip_anchor])  # (2, L)
    holding = [(int(end), int(module)) for end, module in np.argwhere((ends >= 0) & (ends < 4))]
    legs = [(end, module) for end, module in holding if partial_plan.mode[module] == LEG]
    for end, module in holding:
        (partial_plan.base_anchor, partial_plan.tip_anchor)[end][module] = NOWHERE
        if (end, module) in legs:
            partial_plan.mode[module], partial_plan.grounded[module] = DRIVES, 1 - end
    for end, module in holding:
        name = f"{scene.module_names[module]}: let go"
        retract(
            partial_plan, module, compute_end_pose(partial_plan, module, 1 - end), 1 - end, name
        )
    for end, module in legs:
        name = f"{scene.module_names[module]}: stand up"
        root = compute_end_pose(partial_plan, module, 1 - end)
        move_joints(partial_plan, module, root, 1 - end, goal=np.zeros(6), name=name, rng=rng)
    return partial_plan


def bring_module_down(
    partial_plan: PartialPlan, module: int, rng: np.random.Generator
) -> PartialPlan:
    """Return the plan after a module on the terrain by its last end has come down and drives.

    Raises:
        Blocked: The module is on a wall by its first end, or on another module, or has no path.
    """
    scene, base = (
        partial_plan.scene,
        int(partial_plan.base_anchor[module]) - partial_plan.scene.wall_offset,
    )
    if partial_plan.tip_anchor[module] == NOWHERE and (
        base < 0 or compute_ground_end_frame(scene, base)
    ):
        return partial_plan
    if partial_plan.tip_anchor[module] >= len(scene.anchor_names):
        raise Blocked(f"{scene.module_names[module]}: it hangs on another module")
    return climb_down(partial_plan, module, rng)
