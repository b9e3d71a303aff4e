"""Coupled planning of a climb (chapter 5.2): toes and forces by one of several methods.

coupled        P1 with one envelope, P2 convex, IPOPT where that fails
coupled-modes  P1 with one of several envelopes in each round, then P2
coupled-nlp    P1, then IPOPT on everything
coupled-micp   envelopes on a grid: a bound of P, or with a learned envelope a faster search
spatial        SCIP on P itself

The answer is judged by the exact check of P, whatever the method. What the reported bound is valid
for is told with it.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

from climbplan.climb.coupled.accurate import solve_accurate
from climbplan.climb.coupled.envelopes import NamedEnvelope, select_envelopes
from climbplan.climb.coupled.modes import solve_first_stage_with_modes
from climbplan.climb.coupled.preparation import CoupledProblem, prepare_problem
from climbplan.climb.coupled.stages import IntegralPoint, repair_candidate, solve_two_stages
from climbplan.climb.postures.explanation import BOUND_SCOPE
from climbplan.climb.postures.planner import (
    PostureResult,
    extract_rounds,
    note_large_rotations,
    reject_nonconvex,
)
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Unresolved
from climbplan.progress import report_search
from climbplan.solvers.result import SolverResult, relative_gap
from climbplan.solvers.scip.bilinear import solve_minlp_scip

_P = (
    "postures and contact forces of the ends of rounds: rotations linearised, workspaces as balls, "
    "friction pyramids inscribed, every limb carrying posture.min_load"
)
POSTURES_ALONE = f"{_P}; from postures without forces, which is lower"


@dataclass(frozen=True)
class CoupledSolution:
    """The solution of a method."""

    candidate: IntegralPoint
    bound: float  # valid for P
    holds_for: str
    nodes: int
    notes: dict[str, Any] = field(default_factory=dict)


def plan_coupled(scene: ClimbScene, margins: PostureMargins | None = None) -> PostureResult:
    """Plan postures whose forces balance, by the method of the spec.

    Raises:
        Unresolved: Postures alone or P have no solution, or the method finds none.
        LimitReached: The time limit was reached.
    """
    reject_nonconvex(scene)
    start = time.monotonic()
    prepared = prepare_problem(scene, margins or PostureMargins())
    answer = _METHODS[scene.spec.solver.method](prepared)
    x = answer.candidate.x
    objective = prepared.instance.objective(x)
    bound = min(answer.bound, objective)
    gap = relative_gap(objective, bound)
    result = SolverResult(
        status="feasible",
        x=x,
        assignment=answer.candidate.assignment,
        objective=objective,
        bound=bound,
        gap=gap,
        nodes=answer.nodes,
        time=time.monotonic() - start,
        solver=f"{prepared.solver}, {answer.candidate.method}",
        log=(),
    )
    rounds = extract_rounds(prepared.scene, prepared.program, result)
    sizes = {
        **prepared.program.counts(),
        **answer.notes,
        "bound_holds_for": answer.holds_for,
        "seconds": result.time,
    }
    return PostureResult(
        rounds=rounds,
        status="optimal" if gap <= scene.spec.solver.gap else "feasible",
        objective=objective,
        bound=bound,
        gap=gap,
        nodes=answer.nodes,
        solver=result.solver,
        sizes=sizes,
        notes=note_large_rotations(scene, rounds),
    )


def _build_failure(prepared: CoupledProblem, why: str) -> Unresolved:
    method = prepared.scene.spec.solver.method
    return Unresolved(
        f"method {method}: {why}",
        because=f"method {method} searches from one envelope or start",
        stage="posture",
    )


def describe_envelopes(*envelopes: NamedEnvelope) -> dict[str, Any]:
    """Describe envelopes for reports."""
    return {"envelopes": {e.name: e.fit for e in envelopes}}


def _plan_in_stages(prepared: CoupledProblem) -> CoupledSolution:
    options = prepared.scene.spec.solver
    envelope = select_envelopes(prepared.scene)[0]
    local = options.method == "coupled-nlp"
    candidate = solve_two_stages(prepared, envelope.box, prepared.remaining_time, local)
    if candidate is None:
        raise _build_failure(
            prepared, f"no point of P1 with envelope {envelope.name} that P2 or IPOPT puts right"
        )
    return CoupledSolution(
        candidate, prepared.bound, POSTURES_ALONE, prepared.nodes, describe_envelopes(envelope)
    )


def _plan_with_modes(prepared: CoupledProblem) -> CoupledSolution:
    envelopes = select_envelopes(prepared.scene, several=True)
    first = solve_first_stage_with_modes(prepared, envelopes, prepared.remaining_time)
    names = ", ".join(e.name for e in envelopes)
    if first is None:
        raise _build_failure(prepared, f"no point of P1 with envelopes {names}")
    candidate = repair_candidate(prepared, first.candidate, prepared.remaining_time)
    if candidate is None:
        raise _build_failure(prepared, "neither P2 nor IPOPT puts P1 right")
    notes = {**describe_envelopes(*envelopes), "modes": list(first.modes)}
    return CoupledSolution(
        candidate, prepared.bound, POSTURES_ALONE, prepared.nodes + first.nodes, notes
    )


def _find_initial_point(prepared: CoupledProblem) -> IntegralPoint | None:
    """Find a point of P to start from: forces at the postures alone, or IPOPT from there."""
    first = IntegralPoint(prepared.guess, prepared.assignment, "postures")
    return repair_candidate(prepared, first, prepared.remaining_time)


def _report_initial_point(prepared: CoupledProblem, initial: IntegralPoint | None) -> None:
    cost = None if initial is None else prepared.instance.objective(initial.x)
    report_search(cost, prepared.bound)


def _plan_accurately(prepared: CoupledProblem) -> CoupledSolution:
    options = prepared.scene.spec.solver
    envelope = select_envelopes(prepared.scene)[0] if options.envelopes else None
    initial = _find_initial_point(prepared)
    _report_initial_point(prepared, initial)
    if initial is not None and envelope is None:
        cost = prepared.instance.objective(initial.x)
        if relative_gap(cost, prepared.bound) <= options.gap:
            closed = {"closed_by": "postures alone: forces balance at them"}
            return CoupledSolution(
                initial, prepared.bound, f"{_P}; closed by postures alone", 0, closed
            )
    result = solve_accurate(
        prepared,
        initial,
        None if envelope is None else envelope.box,
        solver=options.mip_solver,
        pieces=options.pieces,
        gap=options.gap,
        time_limit=prepared.remaining_time,
    )
    if result.infeasible and envelope is None:
        raise Unresolved(
            f"no postures with forces that balance: the mixed-integer relaxation on "
            f"{options.pieces} pieces has no solution (method {options.method})",
            because=f"the program has {BOUND_SCOPE}; every limb carries posture.min_load",
            stage="posture",
        )
    if result.best is None:
        raise _build_failure(prepared, f"no point of P within {options.time_limit:g} s")
    micp: dict[str, Any] = {
        "binaries": result.binaries,
        "variables": result.variables,
        "rows": result.rows,
        "nodes": result.nodes,
        "tightening_programs": result.tightening,
        "tightening_seconds": result.tightening_time,
        "solver_seconds": result.solver_time,
        "solver": result.solver,
    }
    if envelope is None:
        bound = max(result.bound, prepared.bound)
        scope = f"{_P}; from envelopes on {options.pieces} pieces of each toe coordinate"
        return CoupledSolution(result.best, bound, scope, result.nodes, {"micp": micp})
    micp["value_within_envelope"] = result.bound
    notes = {**describe_envelopes(envelope), "micp": micp}
    scope = (
        f"{POSTURES_ALONE}; the program's own value is that within the envelope, which is no bound"
    )
    return CoupledSolution(result.best, prepared.bound, scope, result.nodes, notes)


def _plan_by_spatial_search(prepared: CoupledProblem) -> CoupledSolution:
    options = prepared.scene.spec.solver
    initial = _find_initial_point(prepared)
    _report_initial_point(prepared, initial)
    result = solve_minlp_scip(
        prepared.instance,
        gap=options.gap,
        time_limit=prepared.remaining_time,
        start=None if initial is None else initial.x,
    )
    if result.status == "infeasible":
        raise Unresolved(
            f"no postures with forces that balance: {result.log[-1]}",
            because=f"the program has {BOUND_SCOPE}; every limb carries posture.min_load",
            stage="posture",
        )
    best = initial
    if result.x is not None and result.assignment is not None and result.objective is not None:
        candidate = IntegralPoint(result.x, result.assignment, "SCIP")
        if initial is None or result.objective < prepared.instance.objective(initial.x):
            best = candidate
    if best is None:
        raise _build_failure(prepared, f"no point of P within {options.time_limit:g} s")
    best = replace(best, method=f"{best.method}, SCIP") if best is initial else best
    notes = {"scip": result.log[-1]}
    return CoupledSolution(
        best, max(result.bound, prepared.bound), f"{_P}; from SCIP", result.nodes, notes
    )


_METHODS = {
    "coupled": _plan_in_stages,
    "coupled-nlp": _plan_in_stages,
    "coupled-modes": _plan_with_modes,
    "coupled-mccormick": _plan_accurately,
    "coupled-minlp-scip": _plan_by_spatial_search,
}
