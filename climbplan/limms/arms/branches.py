"""Arms that hold the box, branch by branch of their inverse kinematics until one serves."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from climbplan.limms.arms.held import plan_held
from climbplan.limms.arms.held_branches import HeldTask, combinations, path_choices
from climbplan.limms.budget.program_results import ProgramOutcome
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.budget.solver_work import Work
from climbplan.limms.motion.densify import Follow
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb

_MOST = 4  # combinations of branches


def delivery(
    scene: Scene, budget: SearchBudget, throw: bool = False, arrival_speed: float = 0.0
) -> HeldTask | None:
    """The box from start to goal through the free space; None without a way there."""
    start, goal = scene.start_placement, scene.goal_placement
    way = find_corridor(decompose_free_space(scene), start, goal)
    if way is None:
        budget.notes.append("there is no way for the box")
        return None
    return HeldTask(start, goal, way, throw, arrival_speed)


def solved_branches(
    scene: Scene,
    limbs: Sequence[Limb],
    task: HeldTask,
    name: str,
    budget: SearchBudget,
) -> Iterator[tuple[Sequence[Limb], ProgramOutcome]]:
    """Branches by which arms at the box (`limbs`) bring it to its goal."""
    choices = path_choices(scene, limbs, task)
    if not all(choices):
        budget.notes.append(f"{name}: out of reach at the start")
        return
    for combo in budget.iterate_choices(combinations(choices, most=_MOST), name):
        outcome = _answered(scene, combo, task, budget)
        budget.record(outcome, name)
        if outcome.solved:
            yield combo, outcome


def _answered(
    scene: Scene, limbs: Sequence[Limb], task: HeldTask, budget: SearchBudget
) -> ProgramOutcome:
    """The answer of the program, which is not solved again where only the pace is another one.

    Arms carry the box as they do at any pace of ways without it. What is known costs no work.
    """
    asked = _as_key((replace(scene, pace=1.0), tuple(limbs), task))
    if asked in budget.cached_outcomes:
        return replace(budget.cached_outcomes[asked], work=Work())
    outcome = plan_held(scene, limbs, task, budget.deadline)
    if not budget.is_expired:  # an answer from then on may be what the clock cut off
        budget.cached_outcomes[asked] = outcome
    return outcome


def _as_key(value: Any) -> Hashable:
    """The same for what has the same content, whatever arrays it is made of."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, BaseModel):
        return value.model_dump_json()
    if is_dataclass(value):
        return tuple(_as_key(getattr(value, field.name)) for field in fields(value))
    return tuple(map(_as_key, value)) if isinstance(value, tuple | list) else value


@contextmanager
def noted(budget: SearchBudget, name: str) -> Iterator[None]:
    """Go on after a motion that is not free all the way, with a note of what is in it."""
    try:
        yield
    except (Blocked, Follow) as error:
        budget.notes.append(f"{name}: {error}")
