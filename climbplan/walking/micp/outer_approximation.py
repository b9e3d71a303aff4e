"""Outer approximation: bounds of a relaxation by linear programs and tangents of its squares.

Squares in the cost are convex. Each linear program has tangents of them as rows; tangents at its
optimum cut off a solution whose squares are too small (Kelley 1960, Duran and Grossmann 1986).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import highspy
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.highs.model import build_rows_model, create_highs, run_highs
from climbplan.walking.micp.linear_model import LinearModel

_MAX_CUT_ROUNDS = 6  # of tangents at the optimum
TANGENT_TOLERANCE = 1e-4  # of the cost, that a square may exceed its tangents by


_FEASIBILITY_TOLERANCE = 1e-7  # of rows; ranges of 1e-9 are within the rounding of HiGHS
_DUAL, _DEVEX = 1, 1
_MAX_ITERATION_FACTOR = 3  # times rows and columns: simplex iterations of a warm start
_FINAL_STATUSES = (
    highspy.HighsModelStatus.kOptimal,
    highspy.HighsModelStatus.kInfeasible,
    highspy.HighsModelStatus.kObjectiveBound,
    highspy.HighsModelStatus.kTimeLimit,
)


def create_lp_solver(time_limit: float = np.inf) -> Any:
    """Return a HiGHS instance for sequences of linear programs with warm starts.

    The dual simplex method uses Devex weights: steepest-edge weights have to be computed from the
    start in each warm start, which takes longer than its iterations.

    Args:
        time_limit: Limit on wall-clock time [s].
    """
    solver = create_highs(time_limit)
    solver.setOptionValue("primal_feasibility_tolerance", _FEASIBILITY_TOLERANCE)
    solver.setOptionValue("simplex_dual_edge_weight_strategy", _DEVEX)
    return solver


def solve_lp(solver: Any) -> Any:
    """Solve a linear program from the current basis.

    A warm start that cycles, or that stops for numerical reasons, is solved again from scratch.

    Returns:
        The model status of HiGHS.
    """
    max_iterations = _MAX_ITERATION_FACTOR * (solver.getNumRow() + solver.getNumCol())
    solver.setOptionValue("simplex_iteration_limit", max_iterations)
    run_highs(solver)
    if (status := solver.getModelStatus()) in _FINAL_STATUSES:
        return status
    return solve_from_scratch(solver)


def solve_from_scratch(solver: Any) -> Any:
    """Solve a linear program with presolve and without a basis, by the dual simplex method.

    Options are restored afterwards.

    Returns:
        The model status of HiGHS.
    """
    options = {name: solver.getOptionValue(name)[1] for name in ("presolve", "simplex_strategy")}
    solver.setOptionValue("presolve", "on")
    solver.setOptionValue("simplex_strategy", _DUAL)
    solver.clearSolver()
    run_highs(solver)
    for name, value in options.items():
        solver.setOptionValue(name, value)
    return solver.getModelStatus()


def confirm_infeasible(solver: Any) -> bool:
    """Return whether a program that a warm start found infeasible is so from scratch, too.

    Rounding in a warm start must not prune a node.
    """
    return bool(solve_from_scratch(solver) == highspy.HighsModelStatus.kInfeasible)


def refine_outer_approximation(
    model: LinearModel, tangent_tolerance: float, solver: Any
) -> Iterator[tuple[float, Array | None]]:
    """Solve the linear relaxation of a model in rounds, with tangents at each optimum.

    The model keeps the tangents.

    Args:
        model: The model, without its integrality.
        tangent_tolerance: Largest violation of a square's tangents that is accepted (a cost).
        solver: HiGHS, whose own limits end the rounds.

    Yields:
        The bound and the solution (n,) of each round; infinity and None if it is infeasible.
    """
    solver.passModel(build_rows_model(model, relaxed=True))
    for _ in range(_MAX_CUT_ROUNDS):
        status = solve_lp(solver)
        if status == highspy.HighsModelStatus.kInfeasible:
            if confirm_infeasible(solver):
                yield np.inf, None
                return
            status = solver.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            return
        x = np.array(solver.getSolution().col_value)
        yield float(solver.getInfo().objective_function_value), x
        first_new_row = len(model)
        if not model.add_violated_tangents(x, tangent_tolerance):
            return
        add_rows(solver, model, first_new_row)


def add_rows(solver: Any, model: LinearModel, first: int) -> None:
    """Add the rows of a model from an index on to a solver that has the earlier ones."""
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
