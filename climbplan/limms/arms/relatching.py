"""Relatching: one module holds the box, releases the ground, and reaches a wall anchor from there.

The box stands meanwhile. On a stable box a module stands as on the ground, one end latched to a
side and the other free. So it reaches anchors that are out of reach from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.limms.arms.branch_choices import rank_branches
from climbplan.limms.arms.branch_search import build_held_task, note_failure, solve_branches
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import (
    build_arm,
    compute_anchor_pose,
    compute_limb_angles,
    compute_side_pose,
)
from climbplan.limms.motion.assembly import latch_box, latch_from_ground, reach_box
from climbplan.limms.motion.between_subtasks import Settle, bring_module_down, keep_plan
from climbplan.limms.motion.densify import add_trajectories
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import reach
from climbplan.limms.motion.straight_motion import retract
from climbplan.limms.motion.stretch_clearance import require_clear_of_all
from climbplan.limms.motion.timeline import (
    ARM,
    DRIVES,
    MANIPULATED,
    NOWHERE,
    STABLE,
    PartialPlan,
    sample_times,
)
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, compute_ground_end_frame
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule


def plan_relatching(
    partial_plan: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    *,
    settle: Settle = keep_plan,
) -> PartialPlan | None:
    """Plan a module that reaches its anchor over the box and carries it; None where it fails."""
    scene, connection = partial_plan.scene, action.connections[0]
    task = build_held_task(scene, budget)
    if task is None:
        return None
    name = action.describe(scene)
    for module in _rank_modules(scene, connection):
        budget.begin(f"{name}: module {scene.module_names[module]} to the box")
        try:
            on_box = latch_to_box(
                partial_plan, module, connection.side, action.releases_ground_anchor, rng
            )
        except Blocked as error:
            budget.notes.append(f"{name}: {error}")
            continue
        box_end = 0 if on_box.base_anchor[module] == connection.side else 1
        root = compute_anchor_pose(scene, connection.root, 1 - box_end)
        limb = build_arm(module, connection.side, root, box_end)
        for arms, outcome in solve_branches(scene, [limb], task, name, budget):
            with note_failure(budget, name):
                return settle(_carry_from_box(on_box, arms[0], connection, outcome, rng))
    return None


def _rank_modules(scene: ModuleScene, connection: Connection) -> Iterator[int]:
    """Yield modules, those nearest to the side of the box first."""
    side_position = compute_side_pose(scene, scene.start_placement, connection.side, 0).position
    ranked = []
    for module in range(scene.num_modules):
        anchor = int(scene.start_anchor[module]) - scene.wall_offset
        position = scene.start_position[module] if anchor < 0 else scene.wall_position[anchor]
        ranked.append((float(np.linalg.norm(position - side_position)), module))
    for _, module in sorted(ranked)[:2]:
        yield module


def latch_to_box(
    partial_plan: PartialPlan,
    module: int,
    side: int,
    releases_ground_anchor: bool,
    rng: np.random.Generator,
) -> PartialPlan:
    """Plan everything until a module is held by a side of the standing box alone.

    Args:
        partial_plan: Where everything is.
        module: The module.
        side: Side of the box.
        releases_ground_anchor: A module on a ground anchor drives first, instead of reaching from
            it.
            A module on a wall reaches from there, or else comes down first.
        rng: Random generator.

    Raises:
        Blocked: No free path was found.
    """
    scene = partial_plan.scene
    name, anchor = scene.module_names[module], int(scene.start_anchor[module])
    if anchor >= 0 and not releases_ground_anchor:
        try:
            return _latch_from_anchor(partial_plan, module, side, rng)
        except Blocked:
            if partial_plan.tip_anchor[module] != anchor:
                raise
            partial_plan = bring_module_down(partial_plan, module, rng)
    elif anchor >= 0 and not compute_ground_end_frame(scene, anchor - scene.wall_offset):
        raise Blocked(f"{name} is latched to a wall and cannot drive")
    target = compute_side_pose(scene, partial_plan.place, side, 1)
    return latch_from_ground(partial_plan, module, target, side, mode=DRIVES, name=name, rng=rng)


def _latch_from_anchor(
    partial_plan: PartialPlan, module: int, side: int, rng: np.random.Generator
) -> PartialPlan:
    """Plan the same for a module on the terrain that releases its anchor once it has the box."""
    scene = partial_plan.scene
    name, anchor = scene.module_names[module], int(scene.start_anchor[module])
    end = 0 if partial_plan.base_anchor[module] == anchor else 1  # that is latched to the terrain
    root = compute_anchor_pose(scene, anchor - scene.wall_offset, end)
    limb = build_arm(module, side, root, 1 - end)
    placement = partial_plan.place[None]
    reason = Blocked(f"{name}: the box is out of reach from where it is latched")
    for _, _, choice in rank_branches(scene, limb, placement, root.position[None]):
        angles, _ = compute_limb_angles(
            scene, choice, placement, root.position[None], choice.branch
        )
        attempt = partial_plan.copy()
        try:
            reach_box(attempt, choice, attempt.place, angles[:1], f"{name}: to the box", rng)
            latch_box(attempt, [choice])
            wait_for_latch(attempt, choice, f"{name}: latch")
            attempt.box_mode = STABLE
            attempt.mode[module] = DRIVES
            (attempt.base_anchor, attempt.tip_anchor)[end][module] = NOWHERE
            held_pose = compute_side_pose(scene, attempt.place, side, 1 - end)
            retract(attempt, module, held_pose, 1 - end, f"{name}: let go")
        except Blocked as error:
            reason = error
            continue
        return attempt
    raise reason


def wait_for_latch(partial_plan: PartialPlan, limb: SupportModule, name: str) -> None:
    """Add a rest for the dwell time of a latch, the arm holding the standing box."""
    scene = partial_plan.scene
    partial_plan.box_mode = MANIPULATED
    stretch = partial_plan.build_rest(name, sample_times(max(scene.module.latch_dwell, 0.05)))
    stretch.force[:, limb.side, 2] = scene.weight
    partial_plan.add(stretch)


def _carry_from_box(
    partial_plan: PartialPlan,
    limb: SupportModule,
    connection: Connection,
    outcome: ProgramOutcome,
    rng: np.random.Generator,
) -> PartialPlan:
    """Plan the motion from the box to the wall, and the carrying of the box.

    Raises:
        Blocked: An approach is not free, or the carrying motion collides.
    """
    scene, module = partial_plan.scene, limb.module
    partial_plan = partial_plan.copy()
    name = f"{scene.module_names[module]}: to the wall"
    root = compute_side_pose(scene, partial_plan.place, limb.side, limb.box_end)
    target = compute_anchor_pose(scene, connection.root, 1 - limb.box_end)
    reach(
        partial_plan,
        module,
        root,
        limb.box_end,
        target=target,
        ending=outcome.traces[0].angles[0, 0],
        name=name,
        rng=rng,
    )
    anchors = partial_plan.tip_anchor if limb.box_end == 0 else partial_plan.base_anchor
    anchors[module] = scene.wall_offset + connection.root
    partial_plan.mode[module] = ARM
    wait_for_latch(partial_plan, limb, f"{scene.module_names[module]}: latch")
    num_stretches = len(partial_plan.stretches)
    add_trajectories(partial_plan, [limb], outcome.traces)
    for stretch in partial_plan.stretches[num_stretches:]:
        require_clear_of_all(scene, stretch)
    return partial_plan
