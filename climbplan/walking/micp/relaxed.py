"""Bounds of a program without its integers, tangents added where its optimum wants them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import highspy
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.highs.model import highs, rows_model, run_highs
from climbplan.walking.micp.model import LinearModel

_ROUNDS = 6  # of tangents at the optimum
SAG = 1e-4  # of the cost that a square may be too small, then


_TOLERANCE = 1e-7  # of rows
_DUAL, _DEVEX = 1, 1
_STEPS = 3  # times as many simplex steps as a program has rows and columns, until it starts anew
_ENDS = (
    highspy.HighsModelStatus.kOptimal,
    highspy.HighsModelStatus.kInfeasible,
    highspy.HighsModelStatus.kObjectiveBound,
    highspy.HighsModelStatus.kTimeLimit,
)


def linear(time_limit: float = np.inf) -> Any:
    """HiGHS as linear programs about ranges need it: 1e-9 of narrow ones is within its rounding.

    Devex weights in its dual simplex method: steepest edges have to be computed anew wherever it
    goes on from, which takes longer than all steps from there.
    """
    solver = highs(time_limit)
    solver.setOptionValue("primal_feasibility_tolerance", _TOLERANCE)
    solver.setOptionValue("simplex_dual_edge_weight_strategy", _DEVEX)
    return solver


def solve_linear(solver: Any) -> Any:
    """Solve a linear program from where the last one ended; HiGHS's status.

    One that goes round in circles there (700,000 steps were seen where 400 are usual), or comes to
    no end by rounding, is solved from scratch.
    """
    steps = _STEPS * (solver.getNumRow() + solver.getNumCol())
    solver.setOptionValue("simplex_iteration_limit", steps)
    run_highs(solver)
    if (status := solver.getModelStatus()) in _ENDS:
        return status
    return from_scratch(solver)


def from_scratch(solver: Any) -> Any:
    """The same with presolve, from no basis, by the dual simplex method."""
    was = {name: solver.getOptionValue(name)[1] for name in ("presolve", "simplex_strategy")}
    solver.setOptionValue("presolve", "on")
    solver.setOptionValue("simplex_strategy", _DUAL)
    solver.clearSolver()
    run_highs(solver)
    for name, value in was.items():
        solver.setOptionValue(name, value)
    return solver.getModelStatus()


def infeasible(solver: Any) -> bool:
    """Whether a program that was found to have no point has none from scratch, either.

    Where a solver goes on from is a matter of speed: what rounding makes of it excludes nothing.
    """
    return bool(from_scratch(solver) == highspy.HighsModelStatus.kInfeasible)


def relaxed(model: LinearModel, sag: float, solver: Any) -> Iterator[tuple[float, Array | None]]:
    """Bounds and points of a program without integers, with ever more tangents.

    Infinity and no point if it has none. The model keeps the tangents; squares are right within
    `sag`, or nearly so, in the end. solver: HiGHS, which ends it by its own limit.
    """
    solver.passModel(rows_model(model, relaxed=True))
    for _ in range(_ROUNDS):
        status = solve_linear(solver)
        if status == highspy.HighsModelStatus.kInfeasible:
            if infeasible(solver):
                yield np.inf, None
                return
            status = solver.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            return
        x = np.array(solver.getSolution().col_value)
        yield float(solver.getInfo().objective_function_value), x
        before = len(model)
        if not model.refine(x, sag):
            return
        add_rows(solver, model, before)  # the next one starts where this one ends


def add_rows(solver: Any, model: LinearModel, first: int) -> None:
    """Hand a solver that holds a model the rows that it got since."""
    rows = model.tail(first)
    solver.addRows(
        rows.shape[0],
        model.row_lower[first:],
        model.row_upper[first:],
        rows.nnz,
        rows.indptr[:-1].astype(np.int32),
        rows.indices.astype(np.int32),
        rows.data,
    )
