"""Chains of arms carry the box from where it stands: carriers, added arms, program, approach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.added_arms import (
    CarrierPose,
    combine_carrier_poses,
    find_carrier_poses,
    find_ground_heights,
)
from climbplan.limms.arms.branch_choices import HeldTask, list_way_points
from climbplan.limms.arms.branch_search import build_held_task, note_failure, solve_branches
from climbplan.limms.arms.carrying import bring_box
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.limbs import build_arm
from climbplan.limms.motion.assembly import compute_end_pose, latch_arm, latch_from_ground
from climbplan.limms.motion.between_subtasks import Settle, bring_module_down, keep_plan
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import move_joints
from climbplan.limms.motion.timeline import ADDED_ARM, PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection, find_module_stands
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule


@dataclass(frozen=True)
class Chain:
    """One connection with its modules; a second module is the added arm."""

    connection: Connection
    modules: tuple[int, ...]


def plan_chain_carrying(
    partial_plan: PartialPlan,
    action: Action,
    budget: SearchBudget,
    rng: np.random.Generator,
    *,
    chains_of_modules: tuple[Chain, ...] | None = None,
    settle: Settle = keep_plan,
) -> PartialPlan | None:
    """Plan the motion of chains of modules that carry the box; None where it fails.

    Args:
        partial_plan: Where everything is.
        action: The action with its connections.
        budget: The budget.
        rng: Random generator.
        chains_of_modules: The chains with their modules; None to assign them.
        settle: Follows the motion.
    """
    scene = partial_plan.scene
    task = build_held_task(scene, budget)
    if task is None:
        return None
    name = action.describe(scene)
    for chains in (
        _assign_modules(scene, action.connections)
        if chains_of_modules is None
        else (chains_of_modules,)
    ):
        budget.begin(f"{name}: arms come to their anchors")
        try:
            with_carriers, poses = _latch_carriers(partial_plan, chains, task, rng)
        except Blocked as error:
            budget.notes.append(f"{name}: {error}")
            continue
        for chosen in combine_carrier_poses(poses):
            try:
                ready, limbs = _latch_added_arms(with_carriers, chains, chosen, rng)
            except Blocked as error:
                budget.notes.append(f"{name}: {error}")
                continue
            for arms, outcome in solve_branches(scene, limbs, task, name, budget):
                with note_failure(budget, name):
                    return settle(bring_box(ready, arms, outcome, rng))
    return None


def _assign_modules(
    scene: ModuleScene, connections: Sequence[Connection]
) -> Iterator[tuple[Chain, ...]]:
    """Yield the assignment of least distance; a module on an anchor starts the chain there."""
    needed = sum(c.links for c in connections)
    best: tuple[float, tuple[int, ...]] | None = None
    stands = find_module_stands(scene)
    for modules in permutations(range(scene.num_modules), needed):
        cost, num_used = 0.0, 0
        for connection in connections:
            anchor = scene.wall_offset + connection.root
            for index in range(connection.links):
                module = modules[num_used + index]
                anchor_at_start = int(scene.start_anchor[module])
                if (anchor_at_start == anchor) != (index == 0 and anchor in scene.start_anchor):
                    cost = np.inf
                elif anchor_at_start != anchor:
                    offset = stands[module] - scene.wall_position[connection.root]
                    cost += float(np.linalg.norm(offset)) * (1.0 if index else 1.001)
            num_used += connection.links
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = (cost, modules)
    if best is None:
        return
    chains, num_used = [], 0
    for connection in connections:
        chains.append(Chain(connection, best[1][num_used : num_used + connection.links]))
        num_used += connection.links
    yield tuple(chains)


def _latch_carriers(
    partial_plan: PartialPlan, chains: Sequence[Chain], task: HeldTask, rng: np.random.Generator
) -> tuple[PartialPlan, list[list[CarrierPose]]]:
    """Latch the first modules of all chains, and find where their free ends may be held.

    Raises:
        Blocked: A module does not reach its anchor, or no pose holds an added arm.
    """
    scene = partial_plan.scene
    for chain in chains:
        name = scene.module_names[chain.modules[0]]
        for index, module in enumerate(chain.modules):
            anchor = scene.wall_offset + chain.connection.root
            if index or anchor not in (
                partial_plan.base_anchor[module],
                partial_plan.tip_anchor[module],
            ):
                partial_plan = bring_module_down(partial_plan, module, rng)
        partial_plan, _ = latch_arm(
            partial_plan, chain.modules[0], chain.connection.root, name, rng
        )
    path = _sample_path(task)
    poses = []
    for chain in chains:
        carrier = chain.modules[0]
        if chain.connection.links == 1:
            end = 0 if partial_plan.base_anchor[carrier] >= 0 else 1
            poses.append(
                [
                    CarrierPose(
                        compute_end_pose(partial_plan, carrier, end),
                        partial_plan.angles[carrier],
                        0.0,
                    )
                ]
            )
            continue
        candidates = find_carrier_poses(
            partial_plan,
            carrier,
            side=chain.connection.side,
            path=path,
            ground=find_ground_heights(scene),
        )
        if not candidates:
            name = scene.module_names[carrier]
            raise Blocked(f"module {name} holds no place from which another serves the way")
        poses.append(candidates)
    return partial_plan, poses


def _sample_path(task: HeldTask) -> Array:
    """Return placements (n, D) along the straight path of the box."""
    corners = list_way_points(task)
    fractions = np.linspace(0, 1, 9)[:, None]
    return np.vstack([first + fractions * (last - first) for first, last in pairwise(corners)])


def _latch_added_arms(
    partial_plan: PartialPlan,
    chains: Sequence[Chain],
    chosen: Sequence[CarrierPose],
    rng: np.random.Generator,
) -> tuple[PartialPlan, list[SupportModule]]:
    """Plan carriers that move their free ends into place, and added arms that latch to them.

    Raises:
        Blocked: No free path was found.
    """
    scene = partial_plan.scene
    partial_plan = partial_plan.copy()
    for chain, pose in zip(chains, chosen, strict=True):
        if chain.connection.links > 1:
            carrier = chain.modules[0]
            wall_end = 0 if partial_plan.base_anchor[carrier] >= 0 else 1
            root = compute_end_pose(partial_plan, carrier, wall_end)
            name = f"{scene.module_names[carrier]}: hold out"
            move_joints(
                partial_plan, carrier, root, wall_end, goal=pose.carrier, name=name, rng=rng
            )
    limbs = []
    for chain, pose in zip(chains, chosen, strict=True):
        carrier, added_arm = chain.modules[0], chain.modules[-1]
        wall_end = 0 if partial_plan.base_anchor[carrier] >= 0 else 1
        box_end = 1 - wall_end
        if chain.connection.links > 1:
            anchor = scene.end_anchor(carrier, 1 - wall_end)
            name = f"{scene.module_names[added_arm]} onto {scene.module_names[carrier]}"
            partial_plan = latch_from_ground(
                partial_plan, added_arm, pose.root, anchor, mode=ADDED_ARM, name=name, rng=rng
            )
            box_end = 0
        limbs.append(build_arm(added_arm, chain.connection.side, pose.root, box_end))
    return partial_plan, limbs
