"""The planner of method `admm`: first integers, consensus, refinement.

Where the blocks do not agree on the first integers, or the refinement fails, a no-good cut excludes
these integers and the next are tried.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.errors import LimitReached, Unresolved
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.consensus.admm import (
    AdmmParameters,
    ConsensusIterate,
    ConsensusRun,
    IterationRecord,
    run_admm,
)
from climbplan.limms.consensus.block_solution import BlockSolution
from climbplan.limms.consensus.conflicts import explain_conflicts
from climbplan.limms.consensus.mixed_integer import GOAL_TOLERANCE, MixedIntegerBlock
from climbplan.limms.consensus.nonlinear import NonlinearBlock
from climbplan.limms.consensus.problem import FORMS, build_problem
from climbplan.limms.consensus.refinement import build_action, refine
from climbplan.limms.motion.plan_making import PlanRecord, make_plan
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.plan.summary import format_failures, format_motion
from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.limms.task_planning.infeasibility import BEHAVIOURS, build_failure
from climbplan.limms.task_planning.single_actions import find_single_actions
from climbplan.progress import Progress


def build_convergence(runs: Sequence[Sequence[IterationRecord]]) -> Convergence:
    """Return the record of all iterations, one choice of modes after another."""
    records = [record for run in runs for record in run]
    residuals = [record.residual for record in records]
    return Convergence(
        attempt=np.concatenate([np.full(len(run), i) for i, run in enumerate(runs)]),
        frozen=np.array([int(record.frozen) for record in records]),
        box_mean=np.array([r.box[0] for r in residuals]),
        box_max=np.array([r.box[1] for r in residuals]),
        points_mean=np.array([r.points[0] for r in residuals]),
        points_max=np.array([r.points[1] for r in residuals]),
        axes_mean=np.array([r.axes[0] for r in residuals]),
        axes_max=np.array([r.axes[1] for r in residuals]),
        missed=np.array([record.goal_error for record in records]),
        violation=np.array([max(record.violation, record.penetration) for record in records]),
        mixed_integer_seconds=np.array([record.mixed_integer_seconds for record in records]),
        nonlinear_seconds=np.array([record.nonlinear_seconds for record in records]),
    )


def format_summary(
    plan: LimmsPlan, best: ConsensusIterate, notes: Sequence[str]
) -> tuple[str, ...]:
    """Return the lines of the summary: problem, blocks, agreement, programs and motion."""
    sizes, times, r = plan.sizes, plan.timings, best.residual
    mass = float(plan.box_mass[0])
    head = f"{plan.name:<16} {sizes['modules']} modules, box {mass:g} kg, method {plan.method}"
    blocks = (
        f"{'blocks':<9} {'built':<9} {times['build_mixed_integer'] + times['build_nonlinear']:.2f}"
        f" s   mixed-integer {sizes['mip_variables']} variables ({sizes['mip_binaries']} binary), "
        f"nonlinear {sizes['nlp_variables']}"
    )
    modes = f"{'modes':<9} {'found':<9} {times['first_integers']:.2f} s   {plan.sequence}"
    if best.worst_rows is not None:
        residual = f"{best.worst_rows.residual:.1g} {best.worst_rows.unit}".rstrip()
        modes += f"; rows hold within {residual} [{best.worst_rows.name}]"
    agreement = (
        f"{'consensus':<9} {'agreed' if r.has_converged else 'apart':<9} "
        f"{times['mixed_integer'] + times['nonlinear']:.2f} s   {sizes['iterations']} iterations, "
        f"mean residuals {1e3 * r.box[0]:.1f} mm (box), {1e3 * r.points[0]:.1f} mm (modules), "
        f"{r.axes[0]:.3f} rad"
    )
    programs = (
        f"{'programs':<9} {sizes['programs']} solved  {times['build'] + times['solve']:.2f} s   "
        f"last one {sizes['variables']} variables, {sizes['constraints']} constraints"
    )
    return (head, blocks, modes, agreement, *format_failures(notes), programs, format_motion(plan))


METHOD = "admm"
CALLBACK_LIMITS = (
    150,
    300,
    600,
    1200,
    2400,
)  # limit checks of HiGHS for first integers, behaviours in turn


class RefinementFailed(LimitReached):
    """No choice of modes led to a plan; the message says how far the blocks agreed."""

    def __init__(self, message: str, convergence: Convergence) -> None:
        super().__init__(message, stage="motion")
        self.convergence = convergence


@dataclass
class PlanningProgress:
    """The progress of planning."""

    agreements: list[ConsensusRun] = field(default_factory=list)
    first_seconds: list[float] = field(default_factory=list)


def plan_by_consensus(
    loaded: LoadedLimms, report: Progress = lambda stage, share: None
) -> LimmsPlan:
    """Plan the motion of a LIMMS spec by consensus.

    Raises:
        Infeasible: Necessary conditions, or the mixed-integer block, exclude every plan.
        LimitReached: No choice of modes led to a plan; the message says how far the best one came.
    """
    start_time = time.perf_counter()
    solver = loaded.spec.solver
    scene = build_scene(loaded)
    report("modes", 0.0)
    candidates = find_single_actions(scene)
    if not candidates.actions:
        raise build_failure(scene, candidates.conflicts)
    problem = build_problem(scene, solver.admm.intervals, FORMS[solver.admm.formulation])
    block, nonlinear = MixedIntegerBlock(problem), NonlinearBlock(problem)
    parameters = AdmmParameters(
        solver.admm.iterations,
        solver.admm.weight_growth,
        solver.admm.weight,
        solver.admm.freeze_after,
    )
    run, budget = PlanningProgress(), SearchBudget(solver.time_limit, solver.max_nlp_solves)
    rng = np.random.default_rng(loaded.spec.seed)
    deadline = budget.deadline
    try:
        while (solution := find_first_integers(scene, block, run, deadline)) is not None:
            consensus = run_admm(
                block,
                nonlinear,
                solution,
                parameters,
                deadline,
                lambda share: report("consensus", share),
            )
            if consensus is not None:
                run.agreements.append(consensus)
                report("refine", 0.0)
                budget.begin(build_action(consensus.best.modes).describe(scene))
                partial_plan = refine(scene, consensus.best, budget, rng)
                if partial_plan is not None:
                    seconds = {"total": time.perf_counter() - start_time}
                    return _build_plan(
                        loaded,
                        scene,
                        partial_plan,
                        block=block,
                        nonlinear=nonlinear,
                        run=run,
                        budget=budget,
                        seconds=seconds,
                    )
            budget.begin("the next choice of modes")
            assert solution.x is not None
            block.add_no_good_cut(solution.x)
    except LimitReached as error:
        raise _build_failure(run, budget) from error
    raise _build_failure(run, budget)


def find_first_integers(
    scene: ModuleScene, block: MixedIntegerBlock, run: PlanningProgress, deadline: float
) -> BlockSolution | None:
    """Find a first solution that reaches the goal, arms first, leaps last.

    Args:
        scene: The scene.
        block: The mixed-integer block.
        run: Receives the seconds of each search.
        deadline: Time after which no search begins, as `time.monotonic` [s].

    Returns:
        The solution, or None where the work limits are reached.

    Raises:
        Infeasible: The bound of the block proves that no solution reaches the goal.
    """
    behaviours = block.behaviours
    distance = float(np.linalg.norm(scene.goal - scene.box_start[0]))
    nearest = dict.fromkeys(behaviours, distance)
    for callbacks in CALLBACK_LIMITS:
        for behaviour in tuple(behaviours):
            if time.monotonic() > deadline:
                return None
            block.fix_behaviour(behaviour)
            solution = block.find_feasible(callbacks, deadline)
            run.first_seconds.append(solution.seconds)
            if solution.goal_error <= GOAL_TOLERANCE:
                return solution
            nearest[behaviour] = min(nearest[behaviour], solution.goal_error)
            if solution.status == "infeasible":
                behaviours.remove(behaviour)
        if not behaviours:
            break
    if behaviours or run.agreements:
        return None
    raise Unresolved(
        f"no modes lead to the goal with {block.problem.intervals} intervals",
        explain_conflicts(block.problem, nearest, deadline),
        because=f"{BEHAVIOURS}, in steps of equal length",
        stage="modes",
    )


def _build_failure(run: PlanningProgress, budget: SearchBudget) -> LimitReached:
    """Return the error that says what was reached within time and work."""
    notes = list(dict.fromkeys(budget.notes))
    is_exhausted = budget.is_expired or budget.remaining <= 0
    limit = (
        budget.describe_limit()
        if is_exhausted
        else "with the work that the mixed-integer block has"
    )
    if not run.agreements:
        text = f"no modes that reach the goal were found {limit}"
        return LimitReached("; ".join([text, *notes]), stage="consensus")
    best = min(run.agreements, key=lambda a: a.best.rank()).best
    r = best.residual
    text = (
        f"no plan {limit}: {len(run.agreements)} choices of modes tried, blocks at best "
        f"{1e3 * r.box[0]:.1f} mm (box), {1e3 * r.points[0]:.1f} mm (modules), "
        f"{r.axes[0]:.3f} rad apart in the mean, but the refinement failed"
    )
    return RefinementFailed(
        "; ".join([text, *notes]), build_convergence([a.steps for a in run.agreements])
    )


def _build_plan(
    loaded: LoadedLimms,
    scene: ModuleScene,
    partial_plan: PartialPlan,
    *,
    block: MixedIntegerBlock,
    nonlinear: NonlinearBlock,
    run: PlanningProgress,
    budget: SearchBudget,
    seconds: dict[str, float],
) -> LimmsPlan:
    """Return the plan with sizes, timings and convergence."""
    records = [record for agreement in run.agreements for record in agreement.steps]
    iterations = sum(record.mixed_integer_seconds for record in records)
    # The first record of each choice of modes repeats the time of the first search
    first_seconds = sum(a.steps[0].mixed_integer_seconds for a in run.agreements)
    programs = nonlinear.programs
    seconds |= {
        "first_integers": sum(run.first_seconds),
        "mixed_integer": iterations - first_seconds,
        "nonlinear": sum(record.nonlinear_seconds for record in records),
        "build_mixed_integer": block.build_seconds,
        "build_nonlinear": programs.build_seconds,
    }
    best = run.agreements[-1].best
    sizes = {
        "intervals": block.problem.intervals,
        "iterations": len(records),
        "best_iterate": best.number,
        "choices_of_modes": len(run.agreements),
        "mip_variables": block.variables,
        "mip_binaries": block.binaries,
        "mip_constraints": block.constraints,
        "nlp_variables": programs.variables * block.problem.intervals,
        "nlp_constraints": programs.constraints * block.problem.intervals,
        "nlp_solves": nonlinear.solves,
    }
    solvers = {
        "mixed_integer": "HiGHS",
        "nonlinear": "IPOPT (CasADi)",
        "programs": "IPOPT (CasADi)",
    }
    name = build_action(best.modes).describe(scene)
    convergence = build_convergence([a.steps for a in run.agreements])
    record_of_plan = PlanRecord(METHOD, name, seconds, sizes, solvers, convergence)
    plan = make_plan(loaded, scene, partial_plan, budget, record_of_plan)
    return replace(plan, summary=format_summary(plan, best, budget.notes))
