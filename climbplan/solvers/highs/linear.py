"""Solve linear programs by HiGHS, for searches that solve thousands of small ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import LimitReached
from climbplan.solvers.highs.model import build_linear_model, create_highs, run_highs

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
            return LinearAnswer(x, float(program.cost @ x))
        if status == highspy.HighsModelStatus.kInfeasible:
            return LinearAnswer(None, np.inf)
    raise LimitReached(f"HiGHS: {solver.modelStatusToString(status)}")
