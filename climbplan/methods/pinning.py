"""The pinned program of a candidate, by whichever solver its form allows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.strategy import Candidate
from climbplan.methods.local import local_method
from climbplan.program.instance import Instance
from climbplan.solvers.result import Answer, SolverResult, judged

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
    local = local_method(
        instance, solver or "form", gap=gap, time_limit=time_limit, tolerance=tolerance
    )
    found = local.solve(candidate, np.inf)
    answer = Answer(
        x=found.x,
        bound=-np.inf,  # what the solver proves is about the pinned program only
        infeasible=False,
        nodes=found.programs,
        time=time.perf_counter() - begin,
        solver=found.solver,
        log=(f"{found.solver}: {found.word}",),
        assignment=candidate.alternatives,
    )
    return judged(instance, answer, gap, tolerance)


def at_point(x: Array, alternatives: IntArray) -> Candidate:
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
