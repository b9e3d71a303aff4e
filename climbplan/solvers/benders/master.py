"""Master problem of Benders decomposition, a mixed-integer linear program in HiGHS.

Minimise z over binaries, subject to all cuts and to the rows that contain integers only. z counts
from the lower bound on the cost, in units of the difference between that and the best answer. The
tolerances of HiGHS are then fractions of what is still to be proved.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.solvers.benders.benders_cuts import CutPlanes
from climbplan.solvers.highs.model import (
    SolverAbandoned,
    build_linear_model,
    create_highs,
    run_highs,
)
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram

_RESCALED = 10.0  # ratio of a new to the current unit of z at which the master is rebuilt
_SAFE = 1e-8  # margin for the row tolerance of HiGHS, in units of z


@dataclass(frozen=True)
class MasterAnswer:
    """Integers to try next, and a lower bound over all integers that are left."""

    integers: IntArray | None  # (E,) None where none satisfy the cuts, or at the time limit
    bound: float
    infeasible: bool
    nodes: int


class Master:
    """The master problem; cuts are added as they are found."""

    def __init__(
        self, form: IndicatorForm, program: MixedIntegerProgram, cost_lower_bound: float
    ) -> None:
        """Begin without cuts, with a lower bound on the cost."""
        self._program, self._cost_lower_bound = program, cost_lower_bound
        self._integer_rows = _select_integer_rows(form, program)
        self._planes: list[CutPlanes] = []
        self._unit = 0.0
        self._solver: Any = None

    def add_cuts(self, planes: CutPlanes, cost: float) -> None:
        """Add cuts.

        Args:
            planes: The cuts at the parameters of the problem.
            cost: Cost of the best answer, infinite without one.
        """
        self._planes += [planes] if len(planes.bound) else []
        unit = self._compute_unit(cost)
        if self._solver is None or not 1.0 / _RESCALED <= unit / self._unit <= _RESCALED:
            self._unit = unit
            self._build()
            return
        rows, ends = self._build_rows(planes)
        for k, end in enumerate(ends):
            span = slice(rows.indptr[k], rows.indptr[k + 1])
            self._solver.addRow(
                float(end), highspy.kHighsInf, span.stop - span.start, rows.indices[span],
                rows.data[span],
            )  # fmt: skip

    def _compute_unit(self, cost: float) -> float:
        """Return the difference of the best answer, or of the lowest cut, to the lower bound."""
        differences = [cost - self._cost_lower_bound]
        if not np.isfinite(cost):
            differences = [
                float(r)
                for p in self._planes
                for r in (p.bound - self._cost_lower_bound)[p.feasible]
            ]
        differences = [r for r in differences if np.isfinite(r) and r > 0.0]
        return max(min(differences, default=1.0), _SAFE * abs(self._cost_lower_bound), 1e-12)

    def _build(self) -> None:
        """Build the model with all rows, in a unit that fits them."""
        n, E = self._program.data, len(self._program.entities)
        integer_rows, low, high = self._integer_rows
        cut_rows = [self._build_rows(planes) for planes in self._planes]
        integer_block = sparse.hstack([integer_rows, sparse.csr_matrix((len(low), 1))])
        count = sum(len(lower_ends) for _, lower_ends in cut_rows)
        lp = build_linear_model(
            np.concatenate([np.zeros(E), [1.0]]),
            sparse.vstack([integer_block, *(rows for rows, _ in cut_rows)]).tocsr(),
            lower=np.concatenate([n.root_low.astype(float), [0.0]]),
            upper=np.concatenate([n.root_high.astype(float), [highspy.kHighsInf]]),
            integer=np.arange(E + 1) < E,
            row_lower=np.concatenate([low, *(lower_ends for _, lower_ends in cut_rows)]),
            row_upper=np.concatenate([high, np.full(count, np.inf)]),
        )
        self._solver = create_highs()
        self._solver.setOptionValue("mip_abs_gap", _SAFE)
        self._solver.passModel(lp)

    def solve(self, gap: float, time_limit: float) -> MasterAnswer:
        """Minimise z to a relative gap."""
        solver = self._solver
        solver.setOptionValue("mip_rel_gap", gap)
        if np.isfinite(time_limit):
            solver.setOptionValue("time_limit", solver.getRunTime() + max(time_limit, 0.0))
        try:
            run_highs(solver, deadline=time.monotonic() + time_limit)
        except SolverAbandoned:
            return MasterAnswer(None, self._cost_lower_bound, False, 0)
        status, info = solver.getModelStatus(), solver.getInfo()
        nodes = max(int(info.mip_node_count), 0)
        if status == highspy.HighsModelStatus.kInfeasible:
            return MasterAnswer(None, np.inf, True, nodes)
        z = float(info.mip_dual_bound)
        bound = (
            self._cost_lower_bound + self._unit * max(z - _SAFE, 0.0)
            if np.isfinite(z)
            else self._cost_lower_bound
        )
        is_feasible = info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
        if not is_feasible:
            return MasterAnswer(None, bound, False, nodes)
        values = np.array(solver.getSolution().col_value)[:-1]
        return MasterAnswer(np.round(values).astype(np.int64), bound, False, nodes)

    def _build_rows(self, planes: CutPlanes) -> tuple[sparse.csr_matrix, Array]:
        """Return rows and lower ends of cuts in (d, z), scaled by the height of each cut."""
        planes = planes.tighten_slopes(self._cost_lower_bound)
        is_useful = np.isfinite(planes.bound) & (
            planes.bound > np.where(planes.feasible, self._cost_lower_bound, 0.0)
        )
        feasible, star = planes.feasible[is_useful], planes.star[is_useful]
        height = np.where(
            feasible, planes.bound[is_useful] - self._cost_lower_bound, planes.bound[is_useful]
        )
        unit = np.where(feasible, np.maximum(height, self._unit), height)
        slope = planes.slope[is_useful] / unit[:, None]
        ends = height / unit - np.where(star, slope, 0.0).sum(axis=1)
        z = np.where(feasible, self._unit / unit, 0.0)
        rows = np.hstack([np.where(star, -slope, slope), z[:, None]])
        return sparse.csr_matrix(rows), ends


def _select_integer_rows(
    form: IndicatorForm, program: MixedIntegerProgram
) -> tuple[sparse.csr_matrix, Array, Array]:
    """Return the plain rows that contain integers only, over these."""
    continuous_weight = abs(form.A) @ (~form.integer).astype(float)
    selected = np.flatnonzero(continuous_weight == 0.0)
    rows = sparse.csr_matrix(form.A[selected])[:, program.entities]
    return sparse.csr_matrix(rows), form.row_lower[selected], form.row_upper[selected]
