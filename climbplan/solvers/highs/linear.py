"""Solve linear programs by HiGHS, for searches that solve thousands of small ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.certificates.rounding import bound_error
from climbplan.errors import LimitReached
from climbplan.solvers.highs.model import build_linear_model, create_highs, run_highs

_ACCURACY = 1e-9  # relative, of slopes along directions without bounds

# Tried one after the other, as HiGHS rarely fails with its default options
_OPTIONS: tuple[dict[str, str | int], ...] = (
    {},
    {"presolve": "off"},
    {"simplex_scale_strategy": 0},
    {"solver": "ipm"},
)


@dataclass(frozen=True)
class LinearProgram:
    """Minimise cost'x subject to lower <= x <= upper and row_lower <= A x <= row_upper."""

    cost: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    A: sparse.csr_matrix  # (m, n)
    row_lower: Array  # (m,)
    row_upper: Array  # (m,)

    def build_model(self, integer: BoolArray) -> Any:
        """Build the HiGHS model; `integer` (n,) marks integer variables."""
        return build_linear_model(
            self.cost,
            self.A,
            lower=self.lower,
            upper=self.upper,
            integer=integer,
            row_lower=self.row_lower,
            row_upper=self.row_upper,
        )


@dataclass(frozen=True)
class LinearAnswer:
    """Solution x (n,) and its cost; None and infinity where HiGHS has proved infeasibility."""

    x: Array | None
    objective: float
    row_dual: Array | None = None  # (m,) gradient of the cost along rows


def solve_linear(program: LinearProgram) -> LinearAnswer:
    """Return an optimal vertex, or that there is none.

    Raises:
        LimitReached: HiGHS ends with neither.
    """
    solver = create_highs()
    solver.passModel(program.build_model(np.zeros(len(program.cost), bool)))
    for options in _OPTIONS:
        solver.clearSolver()  # else HiGHS starts from the basis of the failed attempt
        for option, value in options.items():
            solver.setOptionValue(option, value)
        code = run_highs(solver)
        status = solver.getModelStatus()
        if code == highspy.HighsStatus.kError:
            continue
        if status == highspy.HighsModelStatus.kOptimal:
            x = np.array(solver.getSolution().col_value)
            return LinearAnswer(x, float(program.cost @ x), np.array(solver.getSolution().row_dual))
        if status == highspy.HighsModelStatus.kInfeasible:
            return LinearAnswer(None, np.inf)
    raise LimitReached(f"HiGHS: {solver.modelStatusToString(status)}")


def compute_dual_bound(program: LinearProgram, row_dual: Array) -> float:
    """Return the lower bound on the cost that multipliers of rows (m,) prove by weak duality.

    It holds for any multipliers, however the solver came to them, and is -inf where they prove
    nothing. Where a variable has no bound on the side in question, a slope within the solver's
    accuracy counts as zero.
    """
    side = np.where(row_dual > 0.0, program.row_lower, program.row_upper)
    y = np.where(np.isfinite(side), row_dual, 0.0)
    A = sparse.csr_matrix(program.A)
    slope, sizes = program.cost - A.T @ y, np.abs(program.cost) + abs(A).T @ np.abs(y)
    ends = np.where(slope > 0.0, program.lower, program.upper)
    is_open = ~np.isfinite(ends)
    if (np.abs(slope[is_open]) > _ACCURACY * (1.0 + sizes[is_open])).any():
        return -np.inf
    reach = np.maximum(np.abs(program.lower), np.abs(program.upper))
    reach = np.where(np.isfinite(reach), reach, np.abs(ends))[~is_open]
    values = np.concatenate([y * np.where(y != 0.0, side, 0.0), slope[~is_open] * ends[~is_open]])
    terms = len(y) + len(slope) + 8
    error = float(bound_error(terms, float(np.abs(values).sum())))
    error += float((bound_error(terms, sizes[~is_open]) * reach).sum())
    return float(values.sum()) - error
