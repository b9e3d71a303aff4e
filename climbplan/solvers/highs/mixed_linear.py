"""Solve mixed-integer linear programs by HiGHS."""

from __future__ import annotations

import time
from dataclasses import dataclass

import highspy
import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.solvers.highs.linear import LinearProgram
from climbplan.solvers.highs.model import SolverAbandoned, create_highs, run_highs

_FEASIBLE_POINT = 2  # HiGHS's kSolutionStatusFeasible


@dataclass(frozen=True)
class MixedLinearProgram(LinearProgram):
    """Minimise cost'x subject to bounds and rows, with some integer variables."""

    integer: BoolArray  # (n,)


@dataclass(frozen=True)
class MixedLinearAnswer:
    """The incumbent (n,), None without one, and the bound that was proved."""

    x: Array | None
    objective: float
    bound: float
    infeasible: bool  # proved

    @property
    def gap(self) -> float:
        """Gap relative to the objective; 0 without an incumbent."""
        if self.x is None:
            return 0.0
        return max(0.0, self.objective - self.bound) / max(abs(self.objective), 1e-9)


def solve_mixed_linear(
    program: MixedLinearProgram,
    time_limit: float = np.inf,
    gap: float = 1e-4,
    start: Array | None = None,
) -> MixedLinearAnswer:
    """Find the best point within a time limit.

    Args:
        program: The program.
        time_limit: Time limit [s].
        gap: Relative gap to prove.
        start: (n,) first incumbent.
    """
    solver = create_highs(time_limit, gap)
    solver.passModel(program.build_model(program.integer))
    if start is not None:
        point = highspy.HighsSolution()
        point.col_value = list(start)
        solver.setSolution(point)
    try:
        code = run_highs(solver, deadline=time.monotonic() + time_limit)
    except SolverAbandoned as behind:
        cost = np.inf if behind.x is None else float(program.cost @ behind.x)
        return MixedLinearAnswer(behind.x, cost, behind.bound, False)
    infeasible = solver.getModelStatus() == highspy.HighsModelStatus.kInfeasible
    info, solution = solver.getInfo(), solver.getSolution()
    usable = info.primal_solution_status == _FEASIBLE_POINT and solution.value_valid
    if code == highspy.HighsStatus.kError or not usable:
        return MixedLinearAnswer(None, np.inf, np.inf if infeasible else -np.inf, infeasible)
    x = np.array(solution.col_value)
    return MixedLinearAnswer(x, float(program.cost @ x), float(info.mip_dual_bound), False)
