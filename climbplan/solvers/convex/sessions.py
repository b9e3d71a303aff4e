"""Convex instances (no integers, choices, implications or products) by DAQP, Clarabel or OSQP.

A session is built from one instance; others of the same shape only update numbers, and the active
set or iterate before is the start. Bounds come from the solver's multipliers by weak duality, not
from its word.
"""

from __future__ import annotations

import time
from typing import Literal, Protocol

import numpy as np

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY, Answer, SolverResult, judged

ConvexBackend = Literal["daqp", "clarabel", "osqp"]


class ConvexSession(Protocol):
    """A solver that keeps its workspace between instances of one shape."""

    def solve(self, instance: Instance) -> Answer:
        """Solve the instance, reusing what has not changed."""


def session(backend: ConvexBackend, iterations: int | None = None) -> ConvexSession:
    """A session of one backend; iterations: limit of OSQP (the published 200 or 600)."""
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


def solve_convex(
    instance: Instance,
    backend: ConvexBackend | ConvexSession = "clarabel",
    gap: float = 1e-4,
    tolerance: float = FEASIBILITY,
) -> SolverResult:
    """Solve one instance, in a session of its own or in a given one.

    Raises UsageError if the instance is not convex, or has balls that the backend cannot hold.
    """
    foreign = instance.features - {"balls"}
    if foreign:
        raise UsageError(f"{instance.name}: {', '.join(sorted(foreign))} left, pin or relax first")
    begin = time.perf_counter()
    crossed = (instance.lower > instance.upper).any()
    if crossed or (instance.row_lower > instance.row_upper).any():
        spent = time.perf_counter() - begin
        answer = Answer(None, np.inf, True, 0, spent, "bounds", ("infeasible: bounds cross",))
        return judged(instance, answer, gap, tolerance)
    used = session(backend) if isinstance(backend, str) else backend
    return judged(instance, used.solve(instance), gap, tolerance)
