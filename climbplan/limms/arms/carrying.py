"""Arms carry or throw the box from where it stands: modules, branches, program, approach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from climbplan.limms.arms.branch_search import build_held_task, note_failure, solve_branches
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import build_arm, compute_anchor_pose
from climbplan.limms.motion.assembly import latch_arm, latch_box, reach_box
from climbplan.limms.motion.between_subtasks import Settle, bring_module_down, keep_plan
from climbplan.limms.motion.densify import add_trajectories
from climbplan.limms.motion.stretch_clearance import require_clear_of_all
from climbplan.limms.motion.timeline import NOWHERE, PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, compute_ground_end_frame
from climbplan.limms.scene.phases import SupportModule

_DESCENT_COST = 2.0  # [m] of a descent from a wall, in addition to driving
_MAX_ASSIGNMENTS = 2  # assignments of modules to try


def plan_carrying(
    partial_plan: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    *,
    modules: tuple[int, ...] | None = None,
    settle: Settle = keep_plan,
) -> PartialPlan | None:
    """Plan the motion of arms that carry or throw the box; None where it fails.

    Args:
        partial_plan: Where everything is.
        action: The action with its connections.
        budget: The budget.
        rng: Random generator.
        modules: The module of each connection; None to assign them.
        settle: Follows the motion.
    """
    scene = partial_plan.scene
    task = build_held_task(scene, budget, action.kind == "throw", scene.arrival_speed)
    if task is None:
        return None
    name = action.describe(scene)
    for owners in (
        _rank_assignments(partial_plan, action.connections) if modules is None else (modules,)
    ):
        limbs = [
            build_limb(partial_plan, module, connection)
            for module, connection in zip(owners, action.connections, strict=True)
        ]
        is_solved = False
        for chosen, outcome in solve_branches(scene, limbs, task, name, budget):
            is_solved = True
            with note_failure(budget, name):
                return settle(
                    assemble_carrying(partial_plan, chosen, action.connections, outcome, rng)
                )
        if not is_solved:
            return None  # other modules would fail too, since they are identical
    return None


def _rank_assignments(
    partial_plan: PartialPlan, connections: Sequence[Connection]
) -> Iterator[tuple[int, ...]]:
    """Yield assignments of modules, the shortest distances first; latched modules keep their
    anchors.
    """
    scene = partial_plan.scene
    occupied = set(partial_plan.base_anchor) | set(partial_plan.tip_anchor)
    ranked = []
    for modules in permutations(range(scene.num_modules), len(connections)):
        cost = 0.0
        for module, connection in zip(modules, connections, strict=True):
            anchor = scene.wall_offset + connection.root
            ends = {int(partial_plan.base_anchor[module]), int(partial_plan.tip_anchor[module])}
            if anchor in ends:
                continue
            offset = partial_plan.base_position[module] - scene.wall_position[connection.root]
            cost += float(np.linalg.norm(offset)) + (
                0.0 if _can_drive(partial_plan, ends) else _DESCENT_COST
            )
            if anchor in occupied:
                cost = np.inf
        if np.isfinite(cost):
            ranked.append((cost, modules))
    for _, modules in sorted(ranked)[:_MAX_ASSIGNMENTS]:
        yield modules


def _can_drive(partial_plan: PartialPlan, ends: set[int]) -> bool:
    """Return whether a module with these anchors drives, or stands on one that it can leave."""
    offset, anchors = partial_plan.scene.wall_offset, len(partial_plan.scene.anchor_names)
    return all(
        end == NOWHERE
        or (offset <= end < anchors and compute_ground_end_frame(partial_plan.scene, end - offset))
        for end in ends
    )


def build_limb(partial_plan: PartialPlan, module: int, connection: Connection) -> SupportModule:
    """Return the arm of a module from a terrain anchor to a side of the box."""
    scene = partial_plan.scene
    latched = partial_plan.base_anchor[module] == scene.wall_offset + connection.root
    box_end = 1 if latched else 0
    root = compute_anchor_pose(scene, connection.root, 1 - box_end)
    return build_arm(module, connection.side, root, box_end)


def assemble_carrying(
    partial_plan: PartialPlan,
    limbs: Sequence[SupportModule],
    connections: Sequence[Connection],
    outcome: ProgramOutcome,
    rng: np.random.Generator,
) -> PartialPlan:
    """Plan everything from where the modules are until the box is at its goal.

    Raises:
        Blocked: An approach is not free, or the carrying motion collides.
    """
    scene, partial_plan = partial_plan.scene, partial_plan.copy()
    for limb, connection in zip(limbs, connections, strict=True):
        name = scene.module_names[limb.module]
        ends = partial_plan.base_anchor[limb.module], partial_plan.tip_anchor[limb.module]
        if scene.wall_offset + connection.root not in ends:
            partial_plan = bring_module_down(partial_plan, limb.module, rng)
        partial_plan, _ = latch_arm(partial_plan, limb.module, connection.root, name, rng)
    return bring_box(partial_plan, limbs, outcome, rng)


def bring_box(
    partial_plan: PartialPlan,
    limbs: Sequence[SupportModule],
    outcome: ProgramOutcome,
    rng: np.random.Generator,
) -> PartialPlan:
    """Plan the motion of latched arms to the box, their latching at once, and the carrying.

    Raises:
        Blocked: An approach is not free, or the carrying motion collides.
    """
    scene, partial_plan = partial_plan.scene, partial_plan.copy()
    for i, limb in enumerate(limbs):
        name = f"{scene.module_names[limb.module]}: to the box"
        path = np.concatenate([trace.angles[:, i] for trace in outcome.traces])
        reach_box(partial_plan, limb, outcome.traces[0].position[0], path, name, rng)
    latch_box(partial_plan, limbs)
    num_stretches = len(partial_plan.stretches)
    add_trajectories(partial_plan, limbs, outcome.traces)
    for stretch in partial_plan.stretches[num_stretches:]:
        require_clear_of_all(scene, stretch)
    return partial_plan
