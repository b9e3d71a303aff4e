"""Linear programs as they stand, by HiGHS: for searches that solve thousands of small ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import LimitReached
from climbplan.solvers.highs.model import highs, linear_model, run_highs

# Tried one after the other; a small program in a hundred thousand defeats the first
_WAYS: tuple[dict[str, str | int], ...] = (
    {},
    {"presolve": "off"},
    {"simplex_scale_strategy": 0},
    {"solver": "ipm"},
)


@dataclass(frozen=True)
class LinearProgram:
    """min cost'x over lower <= x <= upper and row_lower <= A x <= row_upper."""

    cost: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    A: sparse.csr_matrix  # (m, n)
    row_lower: Array  # (m,)
    row_upper: Array  # (m,)

    def model(self, integer: BoolArray) -> Any:
        """For HiGHS; integer: (n,) which of x are whole."""
        return linear_model(
            self.cost,
            0.0,
            self.lower,
            self.upper,
            integer,
            self.A,
            self.row_lower,
            self.row_upper,
        )


@dataclass(frozen=True)
class LinearAnswer:
    """x (n,) and its cost; without a solution None and infinity, which HiGHS has proved."""

    x: Array | None
    objective: float


def solve_linear(program: LinearProgram) -> LinearAnswer:
    """An optimal vertex, or no solution.

    Raises LimitReached if HiGHS ends with neither.
    """
    solver = highs()
    solver.passModel(program.model(np.zeros(len(program.cost), bool)))
    for way in _WAYS:
        solver.clearSolver()  # or a try starts from the basis that the last one broke
        for option, value in way.items():
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
