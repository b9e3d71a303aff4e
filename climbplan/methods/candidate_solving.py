"""Solve the program at a candidate's fixed integers, by the solver that its form allows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.strategy import Candidate
from climbplan.methods.local import create_local_method
from climbplan.program.instance import Instance
from climbplan.solvers.result import Answer, SolverResult, judge_answer

FixedIntegerSolver = Literal["ipopt", "sqp", "clarabel", "daqp", "osqp"]
FIXED_INTEGER_SOLVERS: tuple[FixedIntegerSolver, ...] = get_args(FixedIntegerSolver)


def solve_candidate(
    instance: Instance,
    candidate: Candidate,
    solver: FixedIntegerSolver | None = None,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = 1e-6,
) -> SolverResult:
    """Fix the integers of a candidate and solve the rest; the whole instance judges the point.

    The status is "feasible" or "limit", since the integers are a guess.

    Args:
        instance: The instance.
        candidate: Integers, alternatives and start.
        solver: Solver of the rest; by default Clarabel if it is convex, local SQP with products,
            IPOPT with smooth rows.
        gap: Relative gap.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.

    Raises:
        UsageError: Products are left for a convex solver.
    """
    begin = time.perf_counter()
    local = create_local_method(
        instance, solver or "form", gap=gap, time_limit=time_limit, tolerance=tolerance
    )
    solution = local.solve(candidate, np.inf)
    answer = Answer(
        x=solution.x,
        bound=-np.inf,  # what the solver proves is about the program with fixed integers
        infeasible=False,
        nodes=solution.programs,
        time=time.perf_counter() - begin,
        solver=solution.solver,
        log=(f"{solution.solver}: {solution.word}",),
        assignment=candidate.alternatives,
    )
    return judge_answer(instance, answer, gap, tolerance)


def candidate_at(x: Array, alternatives: IntArray) -> Candidate:
    """Return the candidate with a point's integers and the point as start."""
    return Candidate(values=x, alternatives=alternatives, start=x)


def drop_duplicates(candidates: Sequence[Candidate], instance: Instance) -> tuple[Candidate, ...]:
    """Return the candidates in order, without those that repeat an earlier one's integers."""
    first: dict[bytes, Candidate] = {}
    for candidate in candidates:
        key = build_integer_key(instance, candidate.values, candidate.alternatives)
        first.setdefault(key, candidate)
    return tuple(first.values())


def build_integer_key(instance: Instance, x: Array, alternatives: IntArray) -> bytes:
    """Return what is equal for points (n,) with the same integers and alternatives (C,)."""
    integers = np.round(x[instance.integer]).astype(np.int64)
    return np.concatenate([integers, np.asarray(alternatives, np.int64)]).tobytes()
