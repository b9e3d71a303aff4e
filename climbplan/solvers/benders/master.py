"""The program of integers alone that Benders cuts make, in HiGHS.

min z over binaries, with the half-spaces of all cuts and the rows that hold integers only. z is
counted from the least cost that is known, in units of what the best answer is above it: HiGHS's
tolerances are then shares of what is still to be proved.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.solvers.benders.cuts import Planes
from climbplan.solvers.highs.model import LeftBehind, highs, linear_model, run_highs
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram

_RESCALED = 10.0  # times the unit of z, up or down, from which cuts are written in another one
_SAFE = 1e-8  # of the unit of z: what HiGHS's tolerance of rows may be worth


@dataclass(frozen=True)
class MasterAnswer:
    """Integers to try next, and what no integers are below."""

    integers: IntArray | None  # (E,) None: none satisfy the cuts, or the time was over
    bound: float
    infeasible: bool
    nodes: int


class Master:
    """The cuts of one problem; further ones are added as they are found."""

    def __init__(self, form: Conditional, program: MixedIntegerProgram, least: float) -> None:
        self._program, self._least = program, least
        self._integer_rows = _integer_rows(form, program)
        self._planes: list[Planes] = []
        self._unit = 0.0
        self._solver: Any = None

    def add(self, planes: Planes, cost: float) -> None:
        """Further cuts. cost: of the best answer, infinite without one."""
        self._planes += [planes] if len(planes.bound) else []
        unit = self._wanted_unit(cost)
        if self._solver is None or not 1.0 / _RESCALED <= unit / self._unit <= _RESCALED:
            self._unit = unit
            self._build()
            return
        rows, ends = self._rows(planes)
        for k, end in enumerate(ends):
            here = slice(rows.indptr[k], rows.indptr[k + 1])
            self._solver.addRow(
                float(end), highspy.kHighsInf, here.stop - here.start, rows.indices[here],
                rows.data[here],
            )  # fmt: skip

    def _wanted_unit(self, cost: float) -> float:
        """How far the best answer is above the least cost known; without one, the lowest cut."""
        room = [cost - self._least]
        if not np.isfinite(cost):
            room = [float(r) for p in self._planes for r in (p.bound - self._least)[p.feasible]]
        room = [r for r in room if np.isfinite(r) and r > 0.0]
        return max(min(room, default=1.0), _SAFE * abs(self._least), 1e-12)

    def _build(self) -> None:
        """All rows anew, in a unit that fits them."""
        n, E = self._program.numbers, len(self._program.entities)
        whole, low, high = self._integer_rows
        parts = [self._rows(planes) for planes in self._planes]
        first = sparse.hstack([whole, sparse.csr_matrix((len(low), 1))])
        count = sum(len(ends) for _, ends in parts)
        lp = linear_model(
            np.concatenate([np.zeros(E), [1.0]]),
            0.0,
            np.concatenate([n.lowest.astype(float), [0.0]]),
            np.concatenate([n.highest.astype(float), [highspy.kHighsInf]]),
            np.arange(E + 1) < E,
            sparse.vstack([first, *(rows for rows, _ in parts)]).tocsr(),
            np.concatenate([low, *(ends for _, ends in parts)]),
            np.concatenate([high, np.full(count, np.inf)]),
        )
        self._solver = highs()
        self._solver.setOptionValue("mip_abs_gap", _SAFE)
        self._solver.passModel(lp)

    def solve(self, gap: float, time_limit: float) -> MasterAnswer:
        """The least z, good to a relative gap of what it is above the least cost known."""
        solver = self._solver
        solver.setOptionValue("mip_rel_gap", gap)
        if np.isfinite(time_limit):
            solver.setOptionValue("time_limit", solver.getRunTime() + max(time_limit, 0.0))
        try:
            run_highs(solver, deadline=time.monotonic() + time_limit)
        except LeftBehind:
            return MasterAnswer(None, self._least, False, 0)
        status, info = solver.getModelStatus(), solver.getInfo()
        nodes = max(int(info.mip_node_count), 0)
        if status == highspy.HighsModelStatus.kInfeasible:
            return MasterAnswer(None, np.inf, True, nodes)
        z = float(info.mip_dual_bound)
        bound = self._least + self._unit * max(z - _SAFE, 0.0) if np.isfinite(z) else self._least
        found = info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
        if not found:
            return MasterAnswer(None, bound, False, nodes)
        values = np.array(solver.getSolution().col_value)[:-1]
        return MasterAnswer(np.round(values).astype(np.int64), bound, False, nodes)

    def _rows(self, planes: Planes) -> tuple[sparse.csr_matrix, Array]:
        """ends <= rows (d, z), in units of what each cut reaches above the least cost known."""
        planes = planes.above(self._least)
        kept = np.isfinite(planes.bound) & (
            planes.bound > np.where(planes.feasible, self._least, 0.0)
        )
        feasible, star = planes.feasible[kept], planes.star[kept]
        room = np.where(feasible, planes.bound[kept] - self._least, planes.bound[kept])
        unit = np.where(feasible, np.maximum(room, self._unit), room)
        slope = planes.slope[kept] / unit[:, None]
        ends = room / unit - np.where(star, slope, 0.0).sum(axis=1)
        z = np.where(feasible, self._unit / unit, 0.0)
        rows = np.hstack([np.where(star, -slope, slope), z[:, None]])
        return sparse.csr_matrix(rows), ends


def _integer_rows(
    form: Conditional, program: MixedIntegerProgram
) -> tuple[sparse.csr_matrix, Array, Array]:
    """Plain rows that hold integers only, over these."""
    other = abs(form.A) @ (~form.integer).astype(float)
    here = np.flatnonzero(other == 0.0)
    rows = sparse.csr_matrix(form.A[here])[:, program.entities]
    return sparse.csr_matrix(rows), form.row_lower[here], form.row_upper[here]
