"""From a spec to a plan, method `admm`: first integers, consensus, refinement.

Where blocks do not agree on the first integers, or the refinement fails, those are cut off and the
next are tried.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.errors import LimitReached, NotProved
from climbplan.limms.attempts.attempts import Attempts
from climbplan.limms.consensus.conflicts import conflicts_of
from climbplan.limms.consensus.copies import Found
from climbplan.limms.consensus.iteration import Agreement, Iterate, Parameters, Step, agree
from climbplan.limms.consensus.mixed_integer import NEAR_GOAL, MixedInteger
from climbplan.limms.consensus.nonlinear import Nonlinear
from climbplan.limms.consensus.refinement import action_of, refine
from climbplan.limms.consensus.setting import FORMS, setting_of
from climbplan.limms.courses.direct import search
from climbplan.limms.courses.refusal import BEHAVIOURS, ruled_out
from climbplan.limms.motion.plan_making import Making, make_plan
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.plan.summary import motion_line, refused_lines
from climbplan.limms.scene.limms_scene import Scene, scene_of
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.progress import Progress


def convergence_of(runs: Sequence[Sequence[Step]]) -> Convergence:
    """The record of all iterations, those of one choice of modes after those of another."""
    steps = [step for run in runs for step in run]
    residuals = [step.residual for step in steps]
    return Convergence(
        attempt=np.concatenate([np.full(len(run), i) for i, run in enumerate(runs)]),
        frozen=np.array([int(step.frozen) for step in steps]),
        box_mean=np.array([r.box[0] for r in residuals]),
        box_max=np.array([r.box[1] for r in residuals]),
        points_mean=np.array([r.points[0] for r in residuals]),
        points_max=np.array([r.points[1] for r in residuals]),
        axes_mean=np.array([r.axes[0] for r in residuals]),
        axes_max=np.array([r.axes[1] for r in residuals]),
        missed=np.array([step.missed for step in steps]),
        violation=np.array([max(step.violation, step.penetration) for step in steps]),
        mixed_integer_seconds=np.array([step.mixed_integer_seconds for step in steps]),
        nonlinear_seconds=np.array([step.nonlinear_seconds for step in steps]),
    )


def consensus_lines(plan: LimmsPlan, best: Iterate, notes: Sequence[str]) -> tuple[str, ...]:
    """Head, blocks, agreement, program and motion lines as shown on a terminal."""
    sizes, times, r = plan.sizes, plan.timings, best.residual
    mass = float(plan.box_mass[0])
    head = f"{plan.name:<16} {sizes['modules']} modules, box {mass:g} kg, method {plan.method}"
    blocks = (
        f"{'blocks':<9} {'built':<9} {times['build_mixed_integer'] + times['build_nonlinear']:.2f}"
        f" s   mixed-integer {sizes['mip_variables']} variables ({sizes['mip_binaries']} binary), "
        f"nonlinear {sizes['nlp_variables']}"
    )
    modes = f"{'modes':<9} {'found':<9} {times['first_integers']:.2f} s   {plan.sequence}"
    if best.off is not None:
        off = f"{best.off.residual:.1g} {best.off.unit}".rstrip()
        modes += f"; rows hold within {off} [{best.off.name}]"
    agreed = (
        f"{'consensus':<9} {'agreed' if r.good else 'apart':<9} "
        f"{times['mixed_integer'] + times['nonlinear']:.2f} s   {sizes['iterations']} iterations, "
        f"mean residuals {1e3 * r.box[0]:.1f} mm (box), {1e3 * r.points[0]:.1f} mm (modules), "
        f"{r.axes[0]:.3f} rad"
    )
    programs = (
        f"{'programs':<9} {sizes['programs']} solved  {times['build'] + times['solve']:.2f} s   "
        f"last one {sizes['variables']} variables, {sizes['constraints']} constraints"
    )
    return (head, blocks, modes, agreed, *refused_lines(notes), programs, motion_line(plan))


METHOD = "admm"
SLICES = (150, 300, 600, 1200, 2400)  # looks of HiGHS in the first block, behaviours in turn


class Unrefined(LimitReached):
    """No choice of modes that was tried led to a plan; says how far the blocks agreed on each."""

    def __init__(self, message: str, convergence: Convergence) -> None:
        super().__init__(message, stage="motion")
        self.convergence = convergence


@dataclass
class Run:
    """What was done so far."""

    agreements: list[Agreement] = field(default_factory=list)
    first_seconds: list[float] = field(default_factory=list)


def plan_by_consensus(
    loaded: LoadedLimms, report: Progress = lambda stage, share: None
) -> LimmsPlan:
    """The plan of a LIMMS spec by consensus.

    Raises:
        Infeasible: bounds that no plan escapes, or the mixed-integer block, rule every plan out.
        LimitReached: no choice of modes led to a plan; says how far the best one came.
    """
    began = time.perf_counter()
    solver = loaded.spec.solver
    scene = scene_of(loaded)
    report("modes", 0.0)
    bounds = search(scene)
    if not bounds.actions:
        raise ruled_out(scene, bounds.conflicts)
    setting = setting_of(scene, solver.admm.intervals, FORMS[solver.admm.form])
    block, nonlinear = MixedInteger(setting), Nonlinear(setting)
    parameters = Parameters(
        solver.admm.iterations, solver.admm.growth, solver.admm.weight, solver.admm.freeze_after
    )
    run, attempts = Run(), Attempts(solver.time_limit, solver.programs)
    rng = np.random.default_rng(loaded.spec.seed)
    end = attempts.end
    try:
        while (found := first_integers(scene, block, run, end)) is not None:
            agreement = agree(
                block, nonlinear, found, parameters, end, lambda share: report("consensus", share)
            )
            if agreement is not None:
                run.agreements.append(agreement)
                report("refine", 0.0)
                attempts.begin(action_of(agreement.best.modes).named(scene))
                world = refine(scene, agreement.best, attempts, rng)
                if world is not None:
                    seconds = {"total": time.perf_counter() - began}
                    return _plan(loaded, scene, block, nonlinear, run, attempts, world, seconds)
            attempts.begin("the next choice of modes")
            assert found.x is not None
            block.forbid(found.x)
    except LimitReached as error:
        raise _refusal(run, attempts) from error
    raise _refusal(run, attempts)


def first_integers(scene: Scene, block: MixedInteger, run: Run, deadline: float) -> Found | None:
    """A first answer that reaches the goal, arms first, leaps last; None if its work is done.

    deadline: `time.monotonic` [s], after which nothing is begun.

    Raises:
        Infeasible: the block's bound proves that no answer reaches the goal.
    """
    kinds = block.kinds
    distance = float(np.linalg.norm(scene.goal - scene.box_start[0]))
    nearest = dict.fromkeys(kinds, distance)
    for looks in SLICES:
        for kind in tuple(kinds):
            if time.monotonic() > deadline:
                return None
            block.choose(kind)
            found = block.first(looks, deadline)
            run.first_seconds.append(found.seconds)
            if found.missed <= NEAR_GOAL:
                return found
            nearest[kind] = min(nearest[kind], found.missed)
            if found.status == "infeasible":
                kinds.remove(kind)
        if not kinds:
            break
    if kinds or run.agreements:
        return None
    raise NotProved(
        f"no modes lead to the goal with {block.setting.intervals} intervals",
        conflicts_of(block.setting, nearest, deadline),
        because=f"{BEHAVIOURS}, in steps of equal length",
        stage="modes",
    )


def _refusal(run: Run, attempts: Attempts) -> LimitReached:
    """What was reached within time and work."""
    notes = list(dict.fromkeys(attempts.notes))
    ended = attempts.over or attempts.spare <= 0
    bounds = attempts.bounds() if ended else "with the work that the mixed-integer block has"
    if not run.agreements:
        text = f"no modes that reach the goal were found {bounds}"
        return LimitReached("; ".join([text, *notes]), stage="consensus")
    best = min(run.agreements, key=lambda a: a.best.rank()).best
    r = best.residual
    text = (
        f"no plan {bounds}: {len(run.agreements)} choices of modes tried, blocks at best "
        f"{1e3 * r.box[0]:.1f} mm (box), {1e3 * r.points[0]:.1f} mm (modules), "
        f"{r.axes[0]:.3f} rad apart in the mean, but the refinement failed"
    )
    return Unrefined("; ".join([text, *notes]), convergence_of([a.steps for a in run.agreements]))


def _plan(
    loaded: LoadedLimms,
    scene: Scene,
    block: MixedInteger,
    nonlinear: Nonlinear,
    run: Run,
    attempts: Attempts,
    world: PlanSoFar,
    seconds: dict[str, float],
) -> LimmsPlan:
    steps = [step for agreement in run.agreements for step in agreement.steps]
    iterations = sum(step.mixed_integer_seconds for step in steps)
    # The first step of each choice of modes tells the time of the first block again
    again = sum(a.steps[0].mixed_integer_seconds for a in run.agreements)
    programs = nonlinear.programs
    seconds |= {
        "first_integers": sum(run.first_seconds),
        "mixed_integer": iterations - again,
        "nonlinear": sum(step.nonlinear_seconds for step in steps),
        "build_mixed_integer": block.build_seconds,
        "build_nonlinear": programs.build_seconds,
    }
    best = run.agreements[-1].best
    sizes = {
        "intervals": block.setting.intervals,
        "iterations": len(steps),
        "best_iterate": best.number,
        "choices_of_modes": len(run.agreements),
        "mip_variables": block.variables,
        "mip_binaries": block.binaries,
        "mip_constraints": block.constraints,
        "nlp_variables": programs.variables * block.setting.intervals,
        "nlp_constraints": programs.constraints * block.setting.intervals,
        "nlp_solves": nonlinear.solves,
    }
    solvers = {
        "mixed_integer": "HiGHS",
        "nonlinear": "IPOPT (CasADi)",
        "programs": "IPOPT (CasADi)",
    }
    name = action_of(best.modes).named(scene)
    convergence = convergence_of([a.steps for a in run.agreements])
    making = Making(METHOD, name, seconds, sizes, solvers, convergence)
    plan = make_plan(loaded, scene, world, attempts, making)
    return replace(plan, summary=consensus_lines(plan, best, attempts.notes))
