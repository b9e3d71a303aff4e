"""Refinement: modes that both blocks agreed on, planned by the program of `mode-search`."""

from __future__ import annotations

import numpy as np

from climbplan.errors import LimitReached
from climbplan.limms.arms.carrying import plan_carrying
from climbplan.limms.arms.chain_carrying import Chain, plan_chain_carrying
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.consensus.admm import ConsensusIterate
from climbplan.limms.consensus.block_solution import Modes
from climbplan.limms.consensus.problem import FREE, HELD, LEAPS, STANDS
from climbplan.limms.consensus.warm_start import carry_from_iterate
from climbplan.limms.legs.walking import plan_walking
from climbplan.limms.motion.assembly import build_initial_plan
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection
from climbplan.limms.scene.limms_scene import ModuleScene

MAX_PROGRAMS = 60  # programs and sequences of events of one refinement


def find_chains(modes: Modes) -> tuple[Chain, ...]:
    """Return which modules hold the box from where in the first interval of holding."""
    held_intervals = np.flatnonzero(modes.box == HELD)
    if not len(held_intervals):
        return ()
    k = int(held_intervals[0])
    chains = []
    for m in np.flatnonzero(modes.hold[:, k] >= 0):
        parent = int(modes.parent[m, k])
        modules = (int(m),) if parent < 0 else (parent, int(m))
        root = int(modes.wall[modules[0], k])
        chains.append(Chain(Connection(root, int(modes.hold[m, k]), len(modules)), modules))
    chains.sort(key=lambda chain: chain.connection.root)
    return tuple(chains)


def build_action(modes: Modes) -> Action:
    """Return the action of method `mode-search` for these modes."""
    if (modes.box == STANDS).any():
        return Action("quadruped")
    kind = "throw" if (modes.box == FREE).any() else "arms"
    return Action(kind, tuple(chain.connection for chain in find_chains(modes)))


def refine(
    scene: ModuleScene, best: ConsensusIterate, budget: SearchBudget, rng: np.random.Generator
) -> PartialPlan | None:
    """Plan the motion with a fixed mode sequence; None where it fails, with notes in `budget`.

    Raises:
        LimitReached: The budget or time of the whole planning is used up.
    """
    subtask_budget = budget.split(MAX_PROGRAMS)
    try:
        return _plan_refined(scene, best, subtask_budget, rng)
    except LimitReached as error:
        subtask_budget.notes.append(
            f"{build_action(best.modes).describe(scene)}: its share of the work was over"
        )
        if subtask_budget.is_expired or subtask_budget.max_programs >= budget.remaining:
            raise error
        return None
    finally:
        budget.merge(subtask_budget)


def _plan_refined(
    scene: ModuleScene, best: ConsensusIterate, budget: SearchBudget, rng: np.random.Generator
) -> PartialPlan | None:
    """Plan from where the blocks agreed; where that fails, plan as method `mode-search` does.

    A throw starts as in method `mode-search`, since the knots say nothing about its fast intervals.
    """
    modes = best.modes
    action, start = build_action(modes), build_initial_plan(scene)
    if action.kind == "quadruped":
        gait = "leap" if (modes.box == LEAPS).any() else "stand"
        return plan_walking(start, budget, 1, rng, gait_name=gait)
    chains = find_chains(modes)
    if any(len(chain.modules) > 1 for chain in chains):
        return plan_chain_carrying(start, action, budget, rng, chains_of_modules=chains)
    if action.kind == "arms":
        partial_plan = carry_from_iterate(start, action, chains, best, budget, rng)
        if partial_plan is not None:
            return partial_plan
    owners = tuple(chain.modules[0] for chain in chains)
    return plan_carrying(start, action, budget, rng, modules=owners)
