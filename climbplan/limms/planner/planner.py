"""The method `mode-search`: task planning, then trajectory optimisation, then free motion.

Task plans are searched best first. For each one, programs fix keyframes and motions, and sampling
finds the motion of single modules. Which modules latch where follows from the search.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.consensus.planner import plan_by_consensus
from climbplan.limms.modules.weights import PACES, find_weight_conflicts
from climbplan.limms.motion.assembly import build_initial_plan
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.plan_making import PlanRecord, cut_short_warning, make_plan
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.plan.summary import format_plan_summary
from climbplan.limms.planner.motions import TaskPlanExecution
from climbplan.limms.scene.limms_scene import (
    ModuleScene,
    build_scene,
    is_at_goal,
    put_box_first,
    remove_other_boxes,
)
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.limms.task_planning.best_first_search import list_task_plans, search_task_plans
from climbplan.limms.task_planning.infeasibility import build_failure, prove_infeasible
from climbplan.limms.task_planning.single_actions import (
    CandidateActions,
    check_quadruped,
    find_single_actions,
)
from climbplan.progress import Progress

METHOD = "mode-search"
SOLVERS = {"programs": "IPOPT (CasADi)"}


def plan_limms(loaded: LoadedLimms, report: Progress = lambda stage, share: None) -> LimmsPlan:
    """Plan the motion of a LIMMS spec.

    Args:
        loaded: The spec with its module.
        report: Progress callback.

    Returns:
        The plan; `status` is "limit" if the time limit cut it short.

    Raises:
        Infeasible: Necessary conditions exclude every mode sequence.
        LimitReached: No sequence led to a plan, or not in time.
    """
    scene = build_scene(loaded)
    if conflicts := find_weight_conflicts(scene):
        raise Infeasible("no plan exists: modules are too heavy", conflicts, stage="modes")
    if loaded.spec.solver.method == "admm":
        return plan_by_consensus(loaded, report)
    solver = loaded.spec.solver
    budget = SearchBudget(solver.time_limit, solver.max_nlp_solves)
    if scene.massless:
        return _plan_at_pace(loaded, scene, report, budget)[0]
    return _plan_calmest(loaded, scene, report, budget)


def _plan_calmest(
    loaded: LoadedLimms, scene: ModuleScene, report: Progress, budget: SearchBudget
) -> LimmsPlan:
    """Plan with masses at slower and slower paces until the hardware bears the loads.

    Arms carry the box alike at any pace. Without legs, the first pace therefore shows what can be
    found. Legs swing slower at calmer paces, so with legs each pace but the last gets half of the
    remaining budget.

    Raises as `plan_limms`; a plan that fails at every pace is the last one.
    """
    plan: LimmsPlan | None = None
    max_programs, uses_legs = (
        budget.max_programs,
        "quadruped" in scene.allow and not check_quadruped(scene),
    )
    for pace in PACES:
        is_last = pace == PACES[-1]
        budget.max_programs = max_programs - (
            budget.compute_remaining(max_programs) // 2 if uses_legs and not is_last else 0
        )
        try:
            plan, passed = _plan_at_pace(loaded, replace(scene, pace=pace), report, budget)
        except LimitReached:
            if (
                budget.is_expired
                or budget.compute_remaining(max_programs) <= 0
                or is_last
                or not uses_legs
            ):
                if plan is None:
                    raise
                break  # the last plan is written, and marked as failing
        else:
            if passed:
                return plan
    assert plan is not None
    return _mark_cut_short(plan, budget) if budget.is_expired else plan


def _mark_cut_short(plan: LimmsPlan, budget: SearchBudget) -> LimmsPlan:
    """Return a plan with the status and warning that time ran out to improve it."""
    if plan.status == "limit":
        return plan
    warnings = (cut_short_warning(budget.time_limit), *plan.warnings)
    return replace(plan, status="limit", warnings=warnings)


def _plan_at_pace(
    loaded: LoadedLimms, scene: ModuleScene, report: Progress, budget: SearchBudget
) -> tuple[LimmsPlan, bool]:
    """Plan a scene within the remaining budget; return the plan and whether it passes verification.

    Raises as `plan_limms`.
    """
    start_time = time.perf_counter()
    report("modes", 0.0)
    candidates = _find_candidates(scene)
    search_seconds = time.perf_counter() - start_time
    num_tried, label = 0, ""

    def build_plan(partial_plan: PartialPlan) -> LimmsPlan:
        seconds = {"search": search_seconds, "total": time.perf_counter() - start_time}
        sizes = {
            "configurations": candidates.configurations,
            "sequences": max(len(candidates.actions), num_tried),
            "sequences_tried": num_tried,
        }
        record = PlanRecord(METHOD, label, seconds, sizes, dict(SOLVERS))
        plan = make_plan(loaded, scene, partial_plan, budget, record)
        return replace(plan, summary=format_plan_summary(plan, budget.notes))

    start = build_initial_plan(scene)
    rng = np.random.default_rng(loaded.spec.seed)
    verifier = _PlanVerifier(build_plan)
    execution = TaskPlanExecution(start, budget, rng, loaded.spec.solver.max_steps, verifier)
    task_plans = (
        list_task_plans(start, candidates.actions)
        if scene.num_deliveries == 1
        else search_task_plans(start, 1)
    )
    try:
        for index, task_plan in enumerate(task_plans):
            report("plan", index / max(len(candidates.actions), index + 1))
            num_tried, label, num_notes = index + 1, task_plan.describe(scene), len(budget.notes)
            budget.begin(label)
            partial_plan = execution.plan(task_plan)
            if partial_plan is not None:
                return build_plan(partial_plan), verifier.passed
            if len(budget.notes) == num_notes:
                budget.notes.append(f"{label}: no module can take its part")
        budget.require_remaining()
    except LimitReached:
        if verifier.refused is None:
            raise
    if verifier.refused is not None:  # a failing plan is better than none: it is written and marked
        return verifier.refused, False
    if not num_tried:
        raise build_failure(scene, candidates.conflicts)
    raise LimitReached(
        f"no plan found: {num_tried} sequences of modes were tried, and none was proved "
        f"impossible. {budget.describe_failures()}",
        stage="motion",
    )


def _find_candidates(scene: ModuleScene) -> CandidateActions:
    """Return the single actions that bring the only box to its goal; none are listed for several.

    Raises:
        Infeasible: A box provably cannot reach its goal even if it were the only one. Other boxes
            may
            be anywhere by then, so what their places exclude is no proof.
    """
    if scene.num_deliveries == 1:
        candidates = find_single_actions(scene)
        if proof := prove_infeasible(scene, candidates.conflicts):
            raise proof
        return candidates
    places = np.column_stack([scene.box_start, scene.start_yaws])
    goals = np.column_stack([scene.goals, scene.goal_yaws])
    by_box: list[CandidateActions] = []
    for box in range(scene.num_deliveries):
        is_last = box == scene.num_deliveries - 1
        speed = scene.arrival_speed if is_last else 0.0
        box_scene = remove_other_boxes(put_box_first(scene, box, places, goals[box], speed))
        by_box.append(find_single_actions(box_scene))
        proof = prove_infeasible(box_scene, by_box[-1].conflicts)
        if proof is not None and not is_at_goal(scene, box):
            raise Infeasible(
                f"box {box}, were it the only one: {proof}", proof.conflicts, stage="modes"
            )
    conflicts = tuple(conflict for candidates in by_box for conflict in candidates.conflicts)
    return CandidateActions((), conflicts, sum(candidates.configurations for candidates in by_box))


class _PlanVerifier:
    """Verifies complete plans; a failing one is kept, and the search continues.

    Excessive loads are left to slower paces first, as long as there are any.
    """

    def __init__(self, build_plan: Callable[[PartialPlan], LimmsPlan]) -> None:
        self.build_plan = build_plan
        self.passed = False  # whether the plan of the last world passes as it is
        self.refused: LimmsPlan | None = None  # the first that failed

    def __call__(self, world: PartialPlan) -> PartialPlan:
        plan = self.build_plan(world)
        verification = verify_plan(plan)
        self.passed = verification.passed
        failed = [check.name for check in verification.failed]
        if not plan.massless and world.scene.pace > min(PACES):
            failed = [name for name in failed if not name.startswith("load.")]
        if not failed:
            return world
        self.refused = self.refused or plan
        raise Blocked(verification.headline())
