"""Search over branches of the inverse kinematics of arms that hold the box."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from climbplan.limms.arms.branch_choices import HeldTask, combine_choices, rank_branches_on_path
from climbplan.limms.arms.held_program import solve_held_stage
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.budget.solver_work import Work
from climbplan.limms.motion.densify import CannotFollow
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule

_MAX_COMBINATIONS = 4  # combinations of branches


def build_held_task(
    scene: ModuleScene, budget: SearchBudget, throw: bool = False, arrival_speed: float = 0.0
) -> HeldTask | None:
    """Build the task that brings the box from start to goal through free space, or return None."""
    start, goal = scene.start_placement, scene.goal_placement
    corridor = find_corridor(decompose_free_space(scene), start, goal)
    if corridor is None:
        budget.notes.append("there is no way for the box")
        return None
    return HeldTask(start, goal, corridor, throw, arrival_speed)


def solve_branches(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    task: HeldTask,
    name: str,
    budget: SearchBudget,
) -> Iterator[tuple[Sequence[SupportModule], ProgramOutcome]]:
    """Yield branches with which the arms bring the box to its goal, and their solutions."""
    choices = rank_branches_on_path(scene, limbs, task)
    if not all(choices):
        budget.notes.append(f"{name}: out of reach at the start")
        return
    for combo in budget.iterate_choices(
        combine_choices(choices, max_combinations=_MAX_COMBINATIONS), name
    ):
        outcome = _solve_cached(scene, combo, task, budget)
        budget.record(outcome, name)
        if outcome.solved:
            yield combo, outcome


def _solve_cached(
    scene: ModuleScene, limbs: Sequence[SupportModule], task: HeldTask, budget: SearchBudget
) -> ProgramOutcome:
    """Return the solution of a program from the cache where only the pace differs.

    Arms carry the box alike at any pace of motions without it. A cached solution costs no work.
    """
    key = _make_key((replace(scene, pace=1.0), tuple(limbs), task))
    if key in budget.cached_outcomes:
        return replace(budget.cached_outcomes[key], work=Work())
    outcome = solve_held_stage(scene, limbs, task, budget.deadline)
    if not budget.is_expired:  # later solutions may be cut short by the clock
        budget.cached_outcomes[key] = outcome
    return outcome


def _make_key(value: Any) -> Hashable:
    """Return a hashable key of the content of a value."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, BaseModel):
        return value.model_dump_json()
    if is_dataclass(value):
        return tuple(_make_key(getattr(value, field.name)) for field in fields(value))
    return tuple(map(_make_key, value)) if isinstance(value, tuple | list) else value


@contextmanager
def note_failure(budget: SearchBudget, name: str) -> Iterator[None]:
    """Suppress errors of blocked motions, and record them as notes."""
    try:
        yield
    except (Blocked, CannotFollow) as error:
        budget.notes.append(f"{name}: {error}")
