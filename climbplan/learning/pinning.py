"""The pinned program of a candidate, by whichever solver its form allows."""

from __future__ import annotations

import time
from typing import Literal, get_args

import numpy as np

from climbplan.errors import UsageError
from climbplan.learning.candidates import Candidate
from climbplan.program.instance import Instance
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.convex import ConvexBackend, solve_convex
from climbplan.solvers.ipopt import solve_ipopt
from climbplan.solvers.result import Answer, SolverResult, judged

PinnedSolver = Literal["ipopt", "clarabel", "daqp", "osqp"]
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

    solver: Clarabel for a convex rest and IPOPT for one with products if left out. Status is
    "feasible" or "limit": the integers are a guess. Raises UsageError for a convex solver where
    products are left.
    """
    begin = time.perf_counter()
    pinned = PinnedForm.of(instance).at(candidate.x, candidate.assignment, compact=True)
    bilinear = pinned.products.count > 0
    chosen: PinnedSolver = solver or ("ipopt" if bilinear else "clarabel")
    if chosen == "ipopt":
        return solve_ipopt(instance, gap, time_limit, tolerance, candidate.x, candidate.assignment)
    if bilinear:
        raise UsageError(
            f"{instance.name}: {chosen} cannot hold the products that are left when integers are "
            "pinned; use ipopt"
        )
    backend: ConvexBackend = chosen
    found = solve_convex(pinned, backend, gap, tolerance)
    answer = Answer(
        x=found.x,
        bound=-np.inf,  # of the pinned program only
        infeasible=False,
        nodes=1,
        time=time.perf_counter() - begin,
        solver=found.solver,
        log=found.log,
        assignment=candidate.assignment,
    )
    return judged(instance, answer, gap, tolerance)
