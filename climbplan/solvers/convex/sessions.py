"""Solve convex instances (no integers, choices, implications or products) by a choice of backends.

A session is built from one instance. Others of the same shape only update numbers and start from
the last active set or iterate. Bounds follow from the solver's multipliers by weak duality; the
solver's own claims are not used.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from typing import Literal, Protocol

import numpy as np

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY, Answer, SolverResult, judge_answer

ConvexBackend = Literal["daqp", "clarabel", "osqp"]


class ConvexSession(Protocol):
    """A solver that keeps its workspace between instances of one shape."""

    def solve(self, instance: Instance) -> Answer:
        """Solve the instance, reusing what has not changed."""


def create_session(backend: ConvexBackend, iterations: int | None = None) -> ConvexSession:
    """Create a session of one backend; `iterations` limits OSQP (the published 200 or 600)."""
    if backend == "daqp":
        from climbplan.solvers.convex.daqp import DaqpSession

        return DaqpSession()
    if backend == "clarabel":
        from climbplan.solvers.convex.clarabel import ClarabelSession

        return ClarabelSession()
    if backend == "osqp":
        from climbplan.solvers.convex.osqp import OsqpSession

        return OsqpSession() if iterations is None else OsqpSession(iterations)
    raise UsageError(f"unknown convex solver {backend!r}: expected daqp, clarabel or osqp")


def _takes_cones(backend: ConvexBackend | ConvexSession) -> bool:
    """Return whether a backend supports radii that depend on the variables."""
    return backend == "clarabel" or type(backend).__name__ == "ClarabelSession"


def solve_convex(
    instance: Instance,
    backend: ConvexBackend | ConvexSession = "clarabel",
    gap: float = 1e-4,
    tolerance: float = FEASIBILITY,
) -> SolverResult:
    """Solve one instance, in a new session or in a given one.

    Args:
        instance: Convex instance.
        backend: Name of the backend, or a session.
        gap: Relative gap at which the result counts as optimal.
        tolerance: Largest violation of any constraint.

    Raises:
        UsageError: The instance is not convex, or has balls that the backend does not support.
    """
    supported = {"balls", "cones"} if _takes_cones(backend) else {"balls"}
    unsupported = instance.features - supported
    if unsupported:
        raise UsageError(
            f"{instance.name}: {', '.join(sorted(unsupported))} left, pin or relax first"
        )
    begin = time.perf_counter()
    crossed = (instance.lower > instance.upper).any()
    if crossed or (instance.row_lower > instance.row_upper).any():
        duration = time.perf_counter() - begin
        answer = Answer(None, np.inf, True, 0, duration, "bounds", ("infeasible: bounds cross",))
        return judge_answer(instance, answer, gap, tolerance)
    convex_session = create_session(backend) if isinstance(backend, str) else backend
    return judge_answer(instance, convex_session.solve(instance), gap, tolerance)
