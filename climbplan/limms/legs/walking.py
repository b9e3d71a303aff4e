"""The box as the body of a quadruped, from where it stands: gait, footholds, program, assembly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.legs.gaits import generate_gaits
from climbplan.limms.legs.leg_phases import LegBoundary, LegTrajectory
from climbplan.limms.legs.leg_stretches import add_leg_trajectories
from climbplan.limms.legs.motion import compute_leg_motion
from climbplan.limms.legs.quadruped import generate_starts, solve_until_valid
from climbplan.limms.motion.assembly import latch_box, stand_leg
from climbplan.limms.motion.between_subtasks import Settle, bring_module_down, keep_plan, retarget
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule


def plan_walking(
    partial_plan: PartialPlan,
    budget: SearchBudget,
    most_steps: int,
    rng: np.random.Generator,
    *,
    gait_name: str = "",
    settle: Settle = keep_plan,
) -> PartialPlan | None:
    """Plan the motion of a box on four modules as legs; None where it fails.

    Args:
        partial_plan: Where everything is; modules on walls come down first.
        budget: The budget.
        most_steps: Largest number of steps.
        rng: Random generator.
        gait_name: The only gait to try; empty for all.
        settle: Follows the motion.

    Raises:
        LimitReached: The budget or time of the whole planning is used up.
    """
    try:
        partial_plan = _bring_modules_down(partial_plan, rng)
    except Blocked as error:
        budget.notes.append(f"quadruped: {error}")
        return None
    scene = partial_plan.scene
    corridor = find_corridor(decompose_free_space(scene), scene.box_start[0], scene.goal)
    if corridor is None:
        budget.notes.append("there is no way for the box")
        return None
    ends = LegBoundary(scene.box_start[0], scene.goal)
    reach = sum(scene.module.link_lengths[:5])  # the second to last link stands upright
    displacement = scene.goal - scene.box_start[0]
    for gait in generate_gaits(4, len(corridor.blocks), displacement, reach, most_steps):
        if gait_name and gait.name != gait_name:
            continue
        num_starts = 0
        for start in generate_starts(scene, gait, corridor, rng, deadline=budget.deadline):
            num_starts += 1
            budget.begin(f"quadruped, {gait.name}")
            outcome = solve_until_valid(scene, start, ends, budget.deadline)
            budget.record(outcome, f"quadruped, {gait.name}")
            if not outcome.solved:
                continue
            try:
                return settle(_assemble(partial_plan, start.limbs, outcome.traces, budget, rng))
            except Blocked as error:
                budget.notes.append(f"quadruped, {gait.name}: {error}")
        budget.require_remaining()
        if not num_starts:
            budget.notes.append(f"quadruped, {gait.name}: no pose of the legs serves it")
    return None


def _bring_modules_down(partial_plan: PartialPlan, rng: np.random.Generator) -> PartialPlan:
    """Return the plan after modules on walls by their last ends have come down, as legs need them.

    Raises:
        Blocked: A module does not come down.
    """
    scene = partial_plan.scene
    for module in np.flatnonzero(partial_plan.tip_anchor >= 0):
        if (partial_plan.scene.start_anchor < 0).sum() >= 4:
            break
        descended = bring_module_down(partial_plan, int(module), rng)
        partial_plan = retarget(descended, scene.goal_placement, scene.arrival_speed)
    return partial_plan


def _assemble(
    initial: PartialPlan,
    limbs: Sequence[SupportModule],
    trajectories: Sequence[LegTrajectory],
    budget: SearchBudget,
    rng: np.random.Generator,
) -> PartialPlan:
    """Plan modules that drive up and latch at once, and the motion of the box.

    Raises:
        Blocked: A path to the box is not free.
        LimitReached: The budget or time of the whole planning is used up.
    """
    scene, feet = initial.scene, trajectories[0].before
    angles = compute_leg_motion(scene, limbs, trajectories[0]).angles[0]
    reason: Exception | None = None
    for owners in _rank_assignments(scene, feet):
        assigned = [replace(limb, module=m) for limb, m in zip(limbs, owners, strict=True)]
        for order in _list_orders(len(limbs)):
            budget.require_remaining()
            partial_plan = initial.copy()
            try:
                for i in order:
                    stand_leg(partial_plan, assigned[i], feet[i], angles[i], rng)
            except Blocked as error:
                reason = error
                continue
            latch_box(partial_plan, assigned)
            add_leg_trajectories(partial_plan, assigned, trajectories)
            return partial_plan
    raise Blocked(str(reason) if reason else "no module stands on the ground of the footholds")


def _list_orders(n: int) -> Iterator[tuple[int, ...]]:
    """Yield orders in which modules drive up."""
    yield tuple(range(n))
    yield tuple(reversed(range(n)))


def _rank_assignments(scene: ModuleScene, feet: Array) -> Iterator[tuple[int, ...]]:
    """Yield assignments of modules to footholds of the same level, shortest distances first."""
    available = [m for m in range(scene.num_modules) if scene.start_anchor[m] < 0]
    ranked = []
    for modules in permutations(available, len(feet)):
        offsets = scene.start_position[list(modules)] - feet
        if np.abs(offsets[:, 2]).max() > 1e-6:
            continue
        ranked.append((float(np.linalg.norm(offsets, axis=1).sum()), modules))
    ranked.sort()
    for _, modules in ranked[:3]:
        yield modules
