"""P1 and P2 of a climb (chapter 5.2.1): envelopes in place of products, then exact products.

P1 with fixed regions is convex. P2 keeps the toes of P1 and solves for forces: a linear program, or
a quadratic one if forces have a cost. The nonlinear program (IPOPT) moves toes and forces together.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.coupled.preparation import CoupledProblem
from climbplan.climb.coupled.statement import compute_envelope_range
from climbplan.climb.envelopes.search import fix_factors, minimise_product_error
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.ipopt.instances import solve_ipopt
from climbplan.solvers.registry import solve

TOLERANCE = 1e-6  # of P's constraints: metres, weights, weights times metres


@dataclass(frozen=True)
class IntegralPoint:
    """A point with all choices made: of P1, or of P."""

    x: Array
    assignment: IntArray
    method: str  # how it was found


def solve_first_stage(
    prepared: CoupledProblem, fixed_instance: Instance, envelope: Envelope
) -> Array | None:
    """Solve P1 with fixed regions (n,), a convex program; None without a solution."""
    within = compute_envelope_range(prepared.program, fixed_instance, envelope, prepared.origin)
    if (within.lower > within.upper).any():
        return None
    solution = solve_convex(
        LocalForm.of(fixed_instance).at(within), "clarabel", tolerance=TOLERANCE
    ).x
    return None if solution is None else solution[: fixed_instance.size]


def solve_first_stage_with_regions(
    prepared: CoupledProblem, envelope: Envelope, time_limit: float
) -> IntegralPoint | None:
    """Solve P1 with its choice of regions by branch and bound; None without a solution in time."""
    instance = prepared.instance
    within = compute_envelope_range(prepared.program, instance, envelope, prepared.origin)
    if (within.lower > within.upper).any():
        return None
    local = LocalForm.of(instance).at(within)
    solution = solve(local, "branch-and-bound", gap=1e-3, time_limit=time_limit)
    if solution.x is None or solution.assignment is None:
        return None
    return IntegralPoint(solution.x[: instance.size], solution.assignment, "branch and bound")


def solve_second_stage(program: Program, fixed_instance: Instance, x: Array) -> Array | None:
    """Solve P2, which is convex: forces at the postures of P1; None if none balance."""
    force = program.variables["force"]
    is_fixed = np.ones(fixed_instance.size, bool)
    for name in ("force", "moment"):  # moments of feet of finite size follow their forces
        if name in program.variables:
            block = program.variables[name]
            is_fixed[block.start : block.stop] = False
    fixed_columns = np.flatnonzero(is_fixed)
    if fixed_instance.P.indptr[force.stop] > fixed_instance.P.indptr[force.start]:
        solution = solve_convex(
            fix_factors(fixed_instance, x, fixed_columns), "clarabel", tolerance=TOLERANCE
        ).x
    else:
        answer = minimise_product_error(fixed_instance, x, fixed_columns)
        solution = None if answer is None else answer[0]
    if solution is None or fixed_instance.violation(solution) > TOLERANCE:
        return None
    return solution


def solve_nonlinear(fixed_instance: Instance, start: Array, time_limit: float) -> Array | None:
    """Solve for toes and forces together by IPOPT; None if it finds no point of P."""
    return solve_ipopt(fixed_instance, start=start, time_limit=time_limit).x


def repair_candidate(
    prepared: CoupledProblem, first: IntegralPoint, time_limit: float, local: bool = False
) -> IntegralPoint | None:
    """Repair a point of P1 to one of P: by P2, or with `local` (or if P2 fails) by IPOPT."""
    begin = time.monotonic()
    fixed_instance = prepared.fix_choices(first.x, first.assignment)
    if not local:
        solution = solve_second_stage(prepared.program, fixed_instance, first.x)
        if solution is not None:
            return IntegralPoint(solution, first.assignment, f"{first.method}, P2 convex")
    remaining = time_limit - (time.monotonic() - begin)
    solution = solve_nonlinear(fixed_instance, first.x, remaining) if remaining > 0 else None
    return (
        None
        if solution is None
        else IntegralPoint(solution, first.assignment, f"{first.method}, IPOPT")
    )


def solve_two_stages(
    prepared: CoupledProblem, envelope: Envelope, time_limit: float, local: bool = False
) -> IntegralPoint | None:
    """Solve P1 and P2 with the regions of the postures alone; if P1 fails, with its own."""
    begin = time.monotonic()
    fixed_instance = prepared.fix_choices(prepared.guess, prepared.assignment)
    x = solve_first_stage(prepared, fixed_instance, envelope)
    if x is not None:
        candidate = IntegralPoint(x, prepared.assignment, "P1 convex")
        candidate_found = repair_candidate(prepared, candidate, time_limit, local)
        if candidate_found is not None:
            return candidate_found
    remaining = time_limit - (time.monotonic() - begin)
    alternative = (
        solve_first_stage_with_regions(prepared, envelope, remaining) if remaining > 0 else None
    )
    remaining = time_limit - (time.monotonic() - begin)
    if alternative is None or remaining <= 0:
        return None
    return repair_candidate(prepared, alternative, remaining, local)
