"""Motion of a task plan, subtask after subtask from wherever everything is at that time."""

from __future__ import annotations

import numpy as np

from climbplan.limms.arms.carrying import plan_carrying
from climbplan.limms.arms.chain_carrying import plan_chain_carrying
from climbplan.limms.arms.relatching import plan_relatching
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.legs.walking import plan_walking
from climbplan.limms.motion.between_subtasks import (
    Settle,
    keep_plan,
    release_box,
    retarget,
    switch_box,
)
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.actions import Action, Subtask, TaskPlan


class TaskPlanExecution:
    """Plans the motion of task plans from one initial state; common prefixes are planned once."""

    def __init__(
        self,
        start: PartialPlan,
        budget: SearchBudget,
        rng: np.random.Generator,
        most_steps: int,
        settle_last: Settle = keep_plan,
    ) -> None:
        """Initialise from where everything is.

        Args:
            start: The initial partial plan; its scene has boxes in the order of the plan.
            budget: The budget of the planning.
            rng: Random generator of samplers.
            most_steps: Largest number of steps of a walk.
            settle_last: What follows the last subtask.
        """
        self.start, self.budget, self.rng = start, budget, rng
        self.most_steps, self.settle_last = most_steps, settle_last
        self.cached_plans: dict[tuple[Subtask, ...], PartialPlan | None] = {}

    def plan(self, task_plan: TaskPlan) -> PartialPlan | None:
        """Plan the motion until all boxes are at their goals; None where it fails."""
        partial_plan: PartialPlan | None = self.start
        subtasks = task_plan.subtasks
        for number in range(1, len(subtasks)):
            if subtasks[:number] not in self.cached_plans:
                assert partial_plan is not None
                self.cached_plans[subtasks[:number]] = self._plan_subtask(
                    partial_plan, subtasks[number - 1], 0.0, release_box
                )
            partial_plan = self.cached_plans[subtasks[:number]]
            if partial_plan is None:
                return None
        assert partial_plan is not None
        return self._plan_subtask(
            partial_plan, subtasks[-1], self.start.scene.arrival_speed, self.settle_last
        )

    def _plan_subtask(
        self, partial_plan: PartialPlan, subtask: Subtask, speed: float, settle: Settle
    ) -> PartialPlan | None:
        """Plan one subtask; None where it fails."""
        reordered = switch_box(partial_plan, subtask.box, self.start.scene)
        prepared = retarget(reordered, np.array(subtask.end), speed)
        return self._apply_action(prepared, subtask.action, settle)

    def _apply_action(
        self, partial_plan: PartialPlan, action: Action, settle: Settle
    ) -> PartialPlan | None:
        """Plan the motion of an action by the program of its kind."""
        if action.kind == "quadruped":
            return plan_walking(partial_plan, self.budget, self.most_steps, self.rng, settle=settle)
        if action.kind == "relatch":
            return plan_relatching(partial_plan, action, self.budget, self.rng, settle=settle)
        if action.has_chains:
            return plan_chain_carrying(partial_plan, action, self.budget, self.rng, settle=settle)
        return plan_carrying(partial_plan, action, self.budget, self.rng, settle=settle)
