"""The mixed-integer convex relaxation with piecewise McCormick envelopes (`coupled-mccormick`).

P is bounded from below by McCormick envelopes on pieces of the toes' coordinates, with one binary
per piece. (The published logarithmic encoding is slower with HiGHS.) Toes and forces are first
bounded by postures and the cost of a known point (`tightening.py`), so that few pieces suffice.
Without an envelope the bound is valid for P. A learned envelope cuts off points of P: its value is
no bound and is reported as such.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array
from climbplan.climb.coupled.preparation import CoupledProblem
from climbplan.climb.coupled.stages import TOLERANCE, IntegralPoint, solve_nonlinear
from climbplan.climb.coupled.statement import compute_envelope_range
from climbplan.climb.coupled.tightening import find_factors, tighten_bounds
from climbplan.learning.envelope_box import Envelope
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.grids import uniform
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.registry import solve

_TIGHTENING_TIME_FRACTION = 0.4  # of the time limit
_MIN_RANGE = 1e-3  # [m] of toe coordinates that are divided
_BOUND_MARGIN = 1e-5  # added to bounds before they are divided


@dataclass(frozen=True)
class AccurateResult:
    """The result of the mixed-integer program."""

    best: IntegralPoint | None  # of P, exact
    bound: float  # of the mixed-integer program; of P without an envelope
    infeasible: bool  # it has no point: neither has P, without an envelope
    binaries: int
    rows: int
    variables: int
    nodes: int
    tightening: int  # convex programs of the tightening
    tightening_time: float  # [s]
    solver_time: float  # [s]
    solver: str


def build_accurate_program(
    prepared: CoupledProblem, within: ElementwiseRange, pieces: int
) -> Instance:
    """Build P with envelopes on `pieces` of each toe coordinate and choices as binaries."""
    instance = replace(
        prepared.instance, lower=within.lower - _BOUND_MARGIN, upper=within.upper + _BOUND_MARGIN
    )
    toe = prepared.program.variables["toe"]
    grids: dict[int, ArrayLike] = {
        int(j): uniform(instance.lower[j], instance.upper[j], pieces)
        for j in find_factors(instance)
        if toe.start <= j < toe.stop and within.upper[j] - within.lower[j] > _MIN_RANGE
    }
    enveloped = McCormick.on(grids).apply(instance).instance
    return BigM().apply(enveloped).instance if enveloped.choices else enveloped


def solve_accurate(
    prepared: CoupledProblem,
    initial: IntegralPoint | None,
    envelope: Envelope | None,
    *,
    solver: str,
    pieces: int,
    gap: float,
    time_limit: float,
) -> AccurateResult:
    """Tighten bounds, solve the mixed-integer program, and repair its solution by IPOPT.

    initial: a point of P or None; with an envelope it is not used for tightening.
    """
    begin = time.perf_counter()
    instance = prepared.instance
    cost = None if initial is None else instance.objective(initial.x)
    within = ElementwiseRange(instance.lower, instance.upper)
    if envelope is not None:
        within = compute_envelope_range(prepared.program, instance, envelope, prepared.origin)
        cost = None
    tightened = tighten_bounds(instance, within, cost, _TIGHTENING_TIME_FRACTION * time_limit)
    elapsed = time.perf_counter() - begin
    if tightened.infeasible:
        ends = cost if cost is not None else np.inf
        empty = (0, 0, 0, 0, tightened.programs, elapsed, 0.0, "tightening")
        return AccurateResult(initial, ends, cost is None, *empty)
    program = build_accurate_program(prepared, tightened.bounds, pieces)
    start = time.perf_counter()
    solution = solve(program, solver, gap=gap, time_limit=max(time_limit - elapsed, 0.1))
    solver_time = time.perf_counter() - start
    best = initial
    if solution.x is not None:
        remaining = max(time_limit - (time.perf_counter() - begin), 0.1)
        repaired = _repair_solution(prepared, solution.x, remaining)
        if repaired is not None and (cost is None or instance.objective(repaired.x) < cost):
            best = repaired
    infeasible = solution.status == "infeasible"
    bound = solution.bound
    if infeasible and cost is not None:  # nothing is cheaper than the known point
        infeasible, bound = False, cost
    if cost is not None:
        bound = min(bound, cost)
    return AccurateResult(
        best=best,
        bound=bound,
        infeasible=infeasible,
        binaries=program.binary_count,
        rows=program.A.shape[0],
        variables=program.size,
        nodes=solution.nodes,
        tightening=tightened.programs,
        tightening_time=elapsed,
        solver_time=solver_time,
        solver=solution.solver,
    )


def _repair_solution(prepared: CoupledProblem, x: Array, time_limit: float) -> IntegralPoint | None:
    """Repair a solution of the program to a point of P in the same regions."""
    instance = prepared.instance
    first = x[: instance.size]
    assignment = instance.assignment(first)
    fixed_instance = prepared.fix_choices(first, assignment)
    point = solve_nonlinear(fixed_instance, first, time_limit)
    if point is None or fixed_instance.violation(point) > TOLERANCE:
        return None
    return IntegralPoint(point, assignment, "MICP, IPOPT")
