"""Where states can be at all: each one's least and largest value in the relaxed program.

A motion that costs no more than the program's limit has all its states there, so that tube, ranges
and with them all envelopes may be drawn closer: the bound stays one of the first statement.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import highspy
import numpy as np
from numpy.typing import NDArray

from climbplan.solvers.highs.model import highs, rows_model, run_highs
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.micp.tube import Tube
from climbplan.walking.task import ANGLES, POSITION, SPIN, Array

_PAD = 1e-5  # beyond what the solver says: more than its tolerance
_FIXED = 1e-6


@dataclass(frozen=True)
class Box:
    """Least and largest states (N + 1, 12)."""

    low: Array
    high: Array
    off: Array  # (2,) the most that velocities along x and y cost: as of `relaxation`

    def tube(self, tube: Tube) -> Tube:
        """What a tube and the box have in common."""
        a, a_half = _common(
            tube.angles, tube.angles_half, self.low[:, ANGLES], self.high[:, ANGLES]
        )
        s, s_half = _common(tube.spin, tube.spin_half, self.low[:, SPIN], self.high[:, SPIN])
        return replace(tube, angles=a, angles_half=a_half, spin=s, spin_half=s_half)


def shrunk(
    program: Relaxation, seconds: float, clock: Callable[[], float] = time.perf_counter
) -> Box | None:
    """The box of a program's relaxed states; None if it has no point at all.

    Those that time does not suffice for stay as they are. Raises nothing.
    """
    end = clock() + seconds
    model = program.model
    columns = np.array([[c.column for c in row] for row in program.states])
    low, high = np.array(model.lower)[columns], np.array(model.upper)[columns]
    solver = highs()
    solver.setOptionValue("primal_feasibility_tolerance", 1e-7)
    solver.setOptionValue("presolve", "off")  # the next one starts from where the last one ended
    solver.passModel(rows_model(model, relaxed=True))
    everything = np.arange(len(model.lower), dtype=np.int32)
    off = _velocities_cost(program, solver, everything)
    if off is None:
        return None
    solver.changeColsCost(len(everything), everything, np.zeros(len(everything)))
    for n in range(1, len(columns)):
        for k in range(columns.shape[1]):
            if high[n, k] - low[n, k] < _FIXED or k in range(12)[POSITION][:2]:
                continue
            column = int(columns[n, k])
            for sign in (1.0, -1.0):
                left = end - clock()
                if left <= 0:
                    return Box(low, high, off)
                solver.setOptionValue("time_limit", solver.getRunTime() + left)
                solver.changeColCost(column, sign)
                run_highs(solver)
                status = solver.getModelStatus()
                if status == highspy.HighsModelStatus.kInfeasible:
                    return None
                if status == highspy.HighsModelStatus.kOptimal:
                    found = float(solver.getInfo().objective_function_value) - model.constant
                    if sign > 0:
                        low[n, k] = max(low[n, k], found - _PAD)
                    else:
                        high[n, k] = min(high[n, k], -found + _PAD)
            solver.changeColCost(column, 0.0)
            solver.changeColBounds(column, low[n, k], high[n, k])
    return Box(low, high, off)


def _velocities_cost(
    program: Relaxation, solver: Any, everything: NDArray[np.int32]
) -> Array | None:
    """(2,) what all may cost less what all but velocities along x or y costs at least.

    None if the program has no point. Costs of the solver's columns are others afterwards.
    """
    off = np.full(2, program.most)
    for k, columns in enumerate(program.aside):
        cost = np.array(program.model.cost)
        cost[list(columns)] = 0.0
        solver.changeColsCost(len(everything), everything, cost)
        run_highs(solver)
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return None
        if status == highspy.HighsModelStatus.kOptimal:
            others = float(solver.getInfo().objective_function_value)
            left = max(program.most - others, 0.0) + float(program.given[k])
            off[k] = min(off[k], left + _PAD * program.most)
    return off


def _common(middle: Array, half: Array, low: Array, high: Array) -> tuple[Array, Array]:
    below, above = np.maximum(middle - half, low), np.minimum(middle + half, high)
    above = np.maximum(above, below)
    return 0.5 * (below + above), 0.5 * (above - below)
