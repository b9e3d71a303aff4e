"""The pinned program of a candidate, by whichever solver its form allows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from climbplan.errors import UsageError
from climbplan.learning.strategy import Candidate
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.convex.sessions import ConvexBackend, solve_convex
from climbplan.solvers.ipopt.instances import solve_ipopt
from climbplan.solvers.result import Answer, SolverResult, judged
from climbplan.solvers.sqp.method import SqpSolver

PinnedSolver = Literal["ipopt", "sqp", "clarabel", "daqp", "osqp"]
PINNED_SOLVERS: tuple[PinnedSolver, ...] = get_args(PinnedSolver)


def solve_candidate(
    instance: Instance,
    candidate: Candidate,
    solver: PinnedSolver | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
) -> SolverResult:
    """Keep the integers of a candidate and solve what is left; judged on the whole instance.

    solver: if left out, Clarabel for a convex rest, local SQP for one with products, IPOPT for one
    with smooth rows.
    Status is "feasible" or "limit": the integers are a guess. Raises UsageError for a convex solver
    where products are left.
    """
    begin = time.perf_counter()
    chosen_alternatives = candidate.alternatives
    pinned = PinnedForm.of(instance).at(candidate.values, chosen_alternatives, compact=True)
    bilinear = pinned.products.count > 0
    chosen: PinnedSolver = solver or ("sqp" if bilinear else "clarabel")
    if pinned.smooth is not None:
        if solver not in (None, "ipopt"):
            raise UsageError(f"{instance.name}: {solver} cannot hold smooth rows; use ipopt")
        chosen = "ipopt"
    integer = instance.integer
    start = np.where(integer, np.round(candidate.values), candidate.start)
    if chosen == "ipopt":
        return solve_ipopt(instance, gap, time_limit, tolerance, start, chosen_alternatives)
    if chosen == "sqp":
        local = SqpSolver(instance).solve(candidate.values, chosen_alternatives, start)
        x = None if local.x is None or not local.feasible else local.x
        name, count = "sqp", local.programs
        log: tuple[str, ...] = (f"SQP: {local.ending}",)
    elif bilinear:
        raise UsageError(
            f"{instance.name}: {chosen} cannot hold the products that are left when integers are "
            "pinned; use ipopt or sqp"
        )
    else:
        backend: ConvexBackend = chosen
        found = solve_convex(pinned, backend, gap, tolerance)
        x, name, log, count = found.x, found.solver, found.log, 1
    answer = Answer(
        x=x,
        bound=-np.inf,  # what the solver proves is about the pinned program only
        infeasible=False,
        nodes=count,
        time=time.perf_counter() - begin,
        solver=name,
        log=log,
        assignment=chosen_alternatives,
    )
    return judged(instance, answer, gap, tolerance)


def at_point(x: Array, alternatives: Index) -> Candidate:
    """The candidate that a point stands for: its integers, and itself as the start."""
    return Candidate(values=x, alternatives=alternatives, start=x)


def distinct(candidates: Sequence[Candidate], instance: Instance) -> tuple[Candidate, ...]:
    """The candidates in their order, without those that repeat an earlier one's integers."""
    first: dict[bytes, Candidate] = {}
    for candidate in candidates:
        whole = np.round(candidate.values[instance.integer]).astype(np.int64)
        key = np.concatenate([whole, np.asarray(candidate.alternatives, np.int64)]).tobytes()
        first.setdefault(key, candidate)
    return tuple(first.values())
