"""HiGHS models of instances, and the only place of the solvers that runs HiGHS.

A model has rows, bounds and binaries; a quadratic cost only without binaries.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import LimitReached
from climbplan.program.linear_rows import LinearRows
from climbplan.solvers.interruption import interruptible, run_in_thread, run_uninterruptible

_OVERRUN = 0.05  # time after the limit within which HiGHS nearly always stops by itself [s]
_FEASIBILITY = 1e-9  # of rows and integrality; incumbents are checked to 1e-6 afterwards


class QuietHighs(highspy.Highs):
    """HiGHS without output from the start: 1.16 prints its name once it accepts callbacks."""

    def enableCallbacks(self) -> None:
        """Disable output before the constructor enables callbacks."""
        self.setOptionValue("output_flag", False)
        super().enableCallbacks()  # type: ignore[no-untyped-call]


def create_highs(time_limit: float = np.inf, gap: float = 0.0) -> Any:
    """Create a quiet HiGHS on one thread."""
    solver: Any = QuietHighs()  # type: ignore[no-untyped-call]
    solver.setOptionValue("threads", 1)
    solver.setOptionValue("primal_feasibility_tolerance", _FEASIBILITY)
    solver.setOptionValue("mip_feasibility_tolerance", _FEASIBILITY)
    solver.setOptionValue("mip_rel_gap", gap)
    if np.isfinite(time_limit):
        solver.setOptionValue("time_limit", float(max(time_limit, 0.0)))
    return solver


class SolverAbandoned(LimitReached):
    """Report that HiGHS did not stop at its deadline, as within a heuristic, and was abandoned.

    x and bound are those of its last incumbent. The solver must not be used again.
    """

    def __init__(self, x: Array | None, bound: float) -> None:
        super().__init__("HiGHS did not stop at its time limit", stage="solve")
        self.x, self.bound = x, bound


@dataclass
class _ReportedIncumbent:
    """The last incumbent that a mixed-integer search has reported."""

    x: Array | None = None
    bound: float = -np.inf

    def update(self, event: Any) -> None:
        """Update incumbent and bound from a callback."""
        self.x = np.array(event.data_out.mip_solution)
        self.bound = float(event.data_out.mip_dual_bound)


@dataclass
class _StopRequest:
    """A request to stop, which the callbacks of HiGHS fulfil."""

    max_polls: float  # callbacks of a mixed-integer search after which it is stopped anyway
    is_made: bool = False
    num_polls: int = 0

    def make(self) -> None:
        """Request a stop at the next callback."""
        self.is_made = True

    def interrupt_if_made(self, event: Any) -> None:
        """Interrupt HiGHS if a stop was requested."""
        if self.is_made:
            event.interrupt()

    def count_poll(self, event: Any) -> None:
        """Count a callback of a mixed-integer search; interrupt it also after too many."""
        self.num_polls += 1
        if self.is_made or self.num_polls > self.max_polls:
            event.interrupt()


def run_highs(
    solver: Any,
    max_polls: float = np.inf,
    patience: float = np.inf,
    deadline: float = np.inf,
) -> Any:
    """Run HiGHS on its model and return its code; Ctrl-C and SIGTERM end it and are passed on.

    A mixed-integer search polls its callback at the same places of its work on any machine, some
    ten to thirty times a second. The iterations of linear programs are not polled. Quadratic
    programs are solved without polling: a large one is abandoned on a signal.

    Args:
        solver: The solver with its model.
        max_polls: Number of callbacks after which a mixed-integer search is stopped (status
            `kInterrupt`).
        patience: Time [s] after a signal until a search is abandoned; it may be within a heuristic,
            which does not poll. The solver must not be used then.
        deadline: Time of `time.monotonic` [s] of a mixed-integer search.

    Raises:
        SolverAbandoned: The search does not stop at its deadline.
    """
    if entries := solver.getHessianNumNz():
        return run_uninterruptible(solver.run, entries + solver.getNumNz())
    request = _StopRequest(max_polls)
    subscriptions: list[tuple[Any, Callable[[Any], None]]] = [
        (solver.cbMipInterrupt, request.count_poll),
        (solver.cbSimplexInterrupt, request.interrupt_if_made),
        (solver.cbIpmInterrupt, request.interrupt_if_made),
    ]
    incumbent = _ReportedIncumbent()
    if np.isfinite(deadline):
        subscriptions.append((solver.cbMipImprovingSolution, incumbent.update))
    for callback_event, callback in subscriptions:
        callback_event.subscribe(callback)
    has_returned = True
    try:
        if np.isinf(patience) and np.isinf(deadline):
            with interruptible(request.make):
                return solver.run()
        codes: list[Any] = []
        has_returned = run_in_thread(
            lambda: codes.append(solver.run()), request.make, patience, deadline + _OVERRUN
        )
        if not codes:
            raise SolverAbandoned(incumbent.x, incumbent.bound)
        return codes[0]
    finally:
        if has_returned:
            for callback_event, callback in subscriptions:
                callback_event.unsubscribe(callback)


def build_linear_model(
    cost: Array,
    A: sparse.csr_matrix,
    *,
    constant: float = 0.0,
    lower: Array,
    upper: Array,
    integer: BoolArray,
    row_lower: Array,
    row_upper: Array,
) -> Any:
    """Build the model: minimise cost'x + constant subject to bounds and rows."""
    lp = highspy.HighsLp()
    lp.num_col_, lp.num_row_ = len(cost), A.shape[0]
    lp.col_cost_, lp.offset_ = cost, constant
    lp.col_lower_, lp.col_upper_ = lower, upper
    lp.row_lower_, lp.row_upper_ = row_lower, row_upper
    lp.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    lp.a_matrix_.num_col_, lp.a_matrix_.num_row_ = len(cost), A.shape[0]
    lp.a_matrix_.start_, lp.a_matrix_.index_ = A.indptr, A.indices
    lp.a_matrix_.value_ = A.data
    if integer.any():
        types = (highspy.HighsVarType.kContinuous, highspy.HighsVarType.kInteger)
        lp.integrality_ = [types[int(is_integer)] for is_integer in integer]
    return lp


def build_rows_model(rows: LinearRows, relaxed: bool = False) -> Any:
    """Build the model of named rows; `relaxed` drops integrality."""
    return build_linear_model(
        np.array(rows.cost),
        rows.matrix(),
        constant=rows.constant,
        lower=np.array(rows.lower),
        upper=np.array(rows.upper),
        integer=np.array(rows.integer) & (not relaxed),
        row_lower=rows.row_lower,
        row_upper=rows.row_upper,
    )


def build_quadratic_model(lp: Any, P: sparse.csc_matrix) -> Any:
    """Add 1/2 x'Px to a linear model."""
    lower = sparse.tril(P, format="csc")
    lower.sort_indices()
    hessian = highspy.HighsHessian()
    hessian.dim_ = P.shape[0]
    hessian.format_ = highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = lower.indptr, lower.indices, lower.data
    model = highspy.HighsModel()
    model.lp_, model.hessian_ = lp, hessian
    return model
