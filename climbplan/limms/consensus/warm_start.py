"""Warm start of the last program from the best iterate: path of the box, branches of arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.branch_choices import HeldTask
from climbplan.limms.arms.carrying import assemble_carrying, build_limb
from climbplan.limms.arms.chain_carrying import Chain
from climbplan.limms.arms.guess import KNOTS, PathPiece, build_trajectories
from climbplan.limms.arms.held_program import solve_held_stage
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.consensus.admm import ConsensusIterate
from climbplan.limms.consensus.problem import HELD
from climbplan.limms.modules.chain import BRANCHES
from climbplan.limms.modules.limbs import compute_limb_angles
from climbplan.limms.motion.densify import CannotFollow
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule


def carry_from_iterate(
    partial_plan: PartialPlan,
    action: Action,
    chains: Sequence[Chain],
    best: ConsensusIterate,
    budget: SearchBudget,
    rng: np.random.Generator,
) -> PartialPlan | None:
    """Plan single arms that carry the box as the best iterate does; None where that fails."""
    scene = partial_plan.scene
    start = scene.box_start[0]
    corridor = find_corridor(decompose_free_space(scene), start, scene.goal)
    if corridor is None or not chains:
        return None
    task = HeldTask(start, scene.goal, corridor, False, 0.0)
    held_intervals = np.flatnonzero(best.modes.box == HELD)
    path = best.copy.box[held_intervals[0] : held_intervals[-1] + 2]
    limbs = [
        _select_branch(
            scene,
            build_limb(partial_plan, chain.modules[0], chain.connection),
            start,
            best.angles[held_intervals[0], chain.modules[0]],
        )
        for chain in chains
    ]
    guess = build_trajectories(scene, limbs, task, _split_path(task, path, best.held_seconds))
    outcome = solve_held_stage(scene, limbs, task, budget.deadline, guess)
    name = f"{action.describe(scene)}, from the best iterate"
    budget.record(outcome, name)
    if not outcome.solved:
        return None
    try:
        return assemble_carrying(partial_plan, limbs, action.connections, outcome, rng)
    except (Blocked, CannotFollow) as error:
        budget.notes.append(f"{name}: {error}")
        return None


def _select_branch(
    scene: ModuleScene, limb: SupportModule, box: Array, angles: Array
) -> SupportModule:
    """Return the arm with the branch nearest to angles (6,) where it takes the box."""

    def off(branch: tuple[int, int, int]) -> float:
        branch_angles, _ = compute_limb_angles(
            scene, limb, box[None], limb.fixed_position[None], branch
        )
        return float(np.abs(np.sin((branch_angles[0] - angles) / 2)).max())

    return replace(limb, branch=min(BRANCHES, key=off))


def _split_path(task: HeldTask, path: Array, seconds: float) -> list[PathPiece]:
    """Split a path (n, 3) with `seconds` per interval where it enters other blocks."""
    last = len(path) - 1.0
    fine_knots = np.linspace(0, last, 20 * (len(path) - 1) + 1)
    dense = np.column_stack(
        [np.interp(fine_knots, np.arange(len(path)), path[:, i]) for i in range(3)]
    )
    cuts = [0.0]
    for crossing in task.corridor.crossings:
        is_ahead = fine_knots >= cuts[-1] + 0.1
        distances = np.where(is_ahead, np.linalg.norm(dense - crossing, axis=1), np.inf)
        cuts.append(float(fine_knots[int(np.argmin(distances))]))
    cuts.append(last)
    pieces = []
    for begin, end, block in zip(cuts[:-1], cuts[1:], task.corridor.blocks, strict=True):
        knots = np.linspace(begin, end, KNOTS + 1)
        position = np.column_stack(
            [np.interp(knots, np.arange(len(path)), path[:, i]) for i in range(3)]
        )
        position = np.clip(position, block[0], block[1])
        duration = max((end - begin) * seconds, 0.2)
        velocity = np.gradient(position, duration / KNOTS, axis=0)
        pieces.append(PathPiece(position, duration, velocity, block))
    return pieces
