"""An instance as a HiGHS model, and the one place that runs HiGHS.

Rows, bounds, binaries; a quadratic cost only without binaries.
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
from climbplan.solvers.interruption import interruptible, run_aside, run_deaf

_OVERRUN = 0.05  # [s] beyond the time limit that HiGHS keeps by itself nearly always
_FEASIBILITY = 1e-9  # of rows and of integrality: incumbents are checked by us to 1e-6


class QuietHighs(highspy.Highs):
    """HiGHS that says nothing from the start: 1.16 names itself as soon as it takes callbacks."""

    def enableCallbacks(self) -> None:
        """As it comes, which its constructor calls, without output."""
        self.setOptionValue("output_flag", False)
        super().enableCallbacks()  # type: ignore[no-untyped-call]


def highs(time_limit: float = np.inf, gap: float = 0.0) -> Any:
    """A quiet HiGHS on one thread."""
    solver: Any = QuietHighs()  # type: ignore[no-untyped-call]
    solver.setOptionValue("threads", 1)
    solver.setOptionValue("primal_feasibility_tolerance", _FEASIBILITY)
    solver.setOptionValue("mip_feasibility_tolerance", _FEASIBILITY)
    solver.setOptionValue("mip_rel_gap", gap)
    if np.isfinite(time_limit):
        solver.setOptionValue("time_limit", float(max(time_limit, 0.0)))
    return solver


class LeftBehind(LimitReached):
    """HiGHS did not stop at its deadline, as within a heuristic, and was left to itself.

    x, bound: of its last incumbent. Nothing may be done with the solver any more.
    """

    def __init__(self, x: Array | None, bound: float) -> None:
        super().__init__("HiGHS did not stop at its time limit", stage="solve")
        self.x, self.bound = x, bound


@dataclass
class _Incumbent:
    """What a mixed-integer search has told so far."""

    x: Array | None = None
    bound: float = -np.inf

    def learn(self, event: Any) -> None:
        self.x = np.array(event.data_out.mip_solution)
        self.bound = float(event.data_out.mip_dual_bound)


def run_highs(
    solver: Any,
    looks: float = np.inf,
    patience: float = np.inf,
    deadline: float = np.inf,
) -> Any:
    """Solve what it holds, and return HiGHS's code; Ctrl-C and SIGTERM end it and are passed on.

    looks: how often a mixed-integer search may look up before it is stopped (status `kInterrupt`).
    It does so at the same places of its work on any machine, some ten to thirty times a second,
    and the iterations of linear programs, which also count work, it does not tell. patience: [s]
    after a signal until it is left behind, for searches that may be within a heuristic, which does
    not look up: nothing may be done with `solver` then. Quadratic programs HiGHS solves without
    looking up: a large one is left behind.

    deadline: `time.monotonic` [s] of a mixed-integer search, which looks at its time limit no more
    often. Raises LeftBehind where it does not stop.
    """
    if entries := solver.getHessianNumNz():
        return run_deaf(solver.run, entries + solver.getNumNz())
    stopping = False
    looked = 0

    def stop() -> None:
        nonlocal stopping
        stopping = True

    def look(event: Any) -> None:
        if stopping:
            event.interrupt()

    def count(event: Any) -> None:
        nonlocal looked
        looked += 1
        if stopping or looked > looks:
            event.interrupt()

    watched: list[tuple[Any, Callable[[Any], None]]] = [
        (solver.cbMipInterrupt, count),
        (solver.cbSimplexInterrupt, look),
        (solver.cbIpmInterrupt, look),
    ]
    told = _Incumbent()
    if np.isfinite(deadline):
        watched.append((solver.cbMipImprovingSolution, told.learn))
    for moment, watcher in watched:
        moment.subscribe(watcher)
    has_returned = True
    try:
        if np.isinf(patience) and np.isinf(deadline):
            with interruptible(stop):
                return solver.run()
        codes: list[Any] = []
        has_returned = run_aside(
            lambda: codes.append(solver.run()), stop, patience, deadline + _OVERRUN
        )
        if not codes:
            raise LeftBehind(told.x, told.bound)
        return codes[0]
    finally:
        if has_returned:
            for moment, watcher in watched:
                moment.unsubscribe(watcher)


def linear_model(
    cost: Array,
    constant: float,
    lower: Array,
    upper: Array,
    integer: BoolArray,
    A: sparse.csr_matrix,
    row_lower: Array,
    row_upper: Array,
) -> Any:
    """min cost'x + constant over bounds and rows."""
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
        kinds = (highspy.HighsVarType.kContinuous, highspy.HighsVarType.kInteger)
        lp.integrality_ = [kinds[int(whole)] for whole in integer]
    return lp


def rows_model(rows: LinearRows, relaxed: bool = False) -> Any:
    """What was stated as named rows; relaxed: without integrality."""
    return linear_model(
        np.array(rows.cost),
        rows.constant,
        np.array(rows.lower),
        np.array(rows.upper),
        np.array(rows.integer) & (not relaxed),
        rows.matrix(),
        rows.row_lower,
        rows.row_upper,
    )


def quadratic_model(lp: Any, P: sparse.csc_matrix) -> Any:
    """The linear model with 1/2 x'Px added."""
    lower = sparse.tril(P, format="csc")
    lower.sort_indices()
    hessian = highspy.HighsHessian()
    hessian.dim_ = P.shape[0]
    hessian.format_ = highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = lower.indptr, lower.indices, lower.data
    model = highspy.HighsModel()
    model.lp_, model.hessian_ = lp, hessian
    return model
