"""Where motions can be at all: least and largest states, forces and arms of relaxed programs.

A motion that costs no more than the program's limit has all its states there, so that tube, ranges
and with them all envelopes may be drawn closer: the bound stays one of the first statement. Of each
leg and knot two programs ask: what holds if it stands, and whether it may as well swing. What a
point that was found already is near to is not asked (Gleixner et al. 2017, filtering).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import highspy
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.highs.model import rows_model
from climbplan.walking.micp.model import Lin, total
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.relaxed import infeasible, linear, solve_linear
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.task.task import ANGLES, POSITION

_PAD = 1e-5  # beyond what the solver says: more than its tolerance
_WORTH = 0.02  # of a range, that a question has to be able to draw it closer by
_FIXED = 1e-6
_PRIMAL = 4


def shrunk(
    program: Relaxation,
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
    first: int = 0,
) -> Box | None:
    """What is known of a program's motions; None if it has no point at all.

    Only what is at a knot or after it is asked. Whatever time does not suffice for stays as it is.
    Raises nothing.
    """
    asked = _Asked(program, clock() + seconds, clock)
    try:
        if first == 0:
            asked.costs_of_velocities()
        else:
            asked.nothing()
        asked.sums(first)
        asked.legs(first)
        asked.states(first)
    except _NothingThere:
        return None
    except _OutOfTime:
        pass
    return asked.box


class _NothingThere(Exception):
    """The program has no point."""


class _OutOfTime(Exception):
    """Nothing more is asked."""


class _Asked:
    """A relaxed program that is asked for one least or largest value after the other."""

    def __init__(self, program: Relaxation, end: float, clock: Callable[[], float]) -> None:
        self.program, self.end, self.clock = program, end, clock
        model, known = program.model, program.box
        self.columns = np.array([[c.column for c in row] for row in program.states])
        low, high = np.array(model.lower)[self.columns], np.array(model.upper)[self.columns]
        copies = {name: value.copy() for name, value in vars(known).items()}
        self.box = Box(**(copies | {"low": low, "high": high}))
        self.solver = linear()
        self.solver.setOptionValue("presolve", "off")  # the next one starts where this one ends
        self.solver.setOptionValue("simplex_strategy", _PRIMAL)  # costs change, rows do not
        self.solver.passModel(rows_model(model, relaxed=True))
        self.everything = np.arange(len(model.lower), dtype=np.int32)
        self.points = np.empty((0, len(model.lower)))  # of the program with rows as they are

    def solve(self) -> float | None:
        """The least cost of what is asked, None if that is not known."""
        left = self.end - self.clock()
        if left <= 0:
            raise _OutOfTime
        self.solver.setOptionValue("time_limit", self.solver.getRunTime() + left)
        status = solve_linear(self.solver)
        if status == highspy.HighsModelStatus.kInfeasible:
            if infeasible(self.solver):
                raise _NothingThere
            return None
        if status != highspy.HighsModelStatus.kOptimal:
            return None
        self.points = np.vstack([self.points, np.array(self.solver.getSolution().col_value)])
        return float(self.solver.getInfo().objective_function_value)

    def ends(self, value: Lin, low: float, high: float) -> tuple[float, float]:
        """Least and largest of an expression, within what is known of it."""
        columns = np.array(list(value.terms), np.int32)
        factors, constant = np.array(list(value.terms.values())), self.program.model.constant
        try:
            for sign in (1.0, -1.0):
                if self.near(value, low if sign > 0 else high, high - low):
                    continue
                self.solver.changeColsCost(len(columns), columns, sign * factors)
                found = self.solve()
                if found is None:
                    continue
                at = sign * (found - constant) + value.constant
                low, high = (max(low, at - _PAD), high) if sign > 0 else (low, min(high, at + _PAD))
        finally:  # also where there is nothing: what is asked next has costs of its own
            self.solver.changeColsCost(len(columns), columns, np.zeros(len(columns)))
        return low, max(high, low)

    def values(self, value: Lin) -> Array:
        """An expression at all points that hold its rows now."""
        columns = np.array(list(value.terms), np.int64)
        at: Array = self.points[:, columns] @ np.array(list(value.terms.values()))
        return at + value.constant

    def near(self, value: Lin, end: float, width: float) -> bool:
        """Whether a point is so near to an end that its range cannot be drawn closer by much."""
        if not np.isfinite(width) or not len(self.points):
            return False
        return bool(np.abs(self.values(value) - end).min() <= _WORTH * width)

    def nothing(self) -> None:
        """No cost: what is asked next has costs of its own."""
        count = len(self.everything)
        self.solver.changeColsCost(count, self.everything, np.zeros(count))

    def costs_of_velocities(self) -> None:
        """What all may cost less what all but velocities along x or y costs at least.

        Costs of the solver's columns are zero afterwards.
        """
        program, count = self.program, len(self.everything)
        for k, columns in enumerate(program.aside):
            cost = np.array(program.model.cost)
            cost[list(columns)] = 0.0
            self.solver.changeColsCost(count, self.everything, cost)
            others = self.solve()
            if others is not None:
                left = max(program.most - others, 0.0) + float(program.given[k])
                self.box.off[k] = min(self.box.off[k], left + _PAD * program.most)
        self.nothing()

    def states(self, first: int = 0) -> None:
        """Ranges of states but positions along x and y, after a knot."""
        low, high = self.box.low, self.box.high
        for n in range(first + 1, len(low)):
            for k in range(low.shape[1] if n <= self.program.turned else ANGLES.start):
                if high[n, k] - low[n, k] < _FIXED or k in range(12)[POSITION][:2]:
                    continue
                column = int(self.columns[n, k])
                if not np.isfinite(high[n, k] - low[n, k]):  # the last turning, which turns nothing
                    continue
                low[n, k], high[n, k] = self.ends(Lin({column: 1.0}), low[n, k], high[n, k])
                self.solver.changeColBounds(column, low[n, k], high[n, k])

    def sums(self, first: int = 0) -> None:
        """Ranges of the sums of forces from a knot on, by what they change velocities by."""
        program, box = self.program, self.box
        for n in range(first, len(program.pieces)):
            legs = program.pieces[n]
            for k in range(3):
                force = total(q.force[k] for leg in legs for q in leg)
                low, high = box.push_low[n, k], box.push_high[n, k]
                box.push_low[n, k], box.push_high[n, k] = self.ends(force, low, high)

    def legs(self, first: int = 0) -> None:
        """Whether legs stand from a knot on, and arms and forces of those that do."""
        program, box = self.program, self.box
        for n in range(first, len(program.pieces)):
            for leg, pieces in enumerate(program.pieces[n]):
                row, share = int(program.rows[n, leg]), total(q.chosen for q in pieces)
                low, high = box.stands_low[n, leg], box.stands_high[n, leg]
                if high == 0.0:
                    continue
                known, stands = self.points, self.values(share)
                self.solver.changeRowBounds(row, 1.0, 1.0)
                self.points = known[stands > 1.0 - _FIXED]
                old = len(self.points)
                try:
                    force = total(q.force[2] for q in pieces)
                    ends = box.force_low[n, leg, 2], box.force_high[n, leg, 2]
                    box.force_low[n, leg, 2], box.force_high[n, leg, 2] = self.ends(force, *ends)
                    for k in range(2 if n else 0):
                        arm = total(q.arm[k] for q in pieces)
                        ends = box.arm_low[n, leg, k], box.arm_high[n, leg, k]
                        box.arm_low[n, leg, k], box.arm_high[n, leg, k] = self.ends(arm, *ends)
                except _NothingThere:
                    high = 0.0
                known = np.vstack([known, self.points[old:]])
                if high > 0.0 and low == 0.0 and not (stands < _FIXED).any():
                    self.solver.changeRowBounds(row, 0.0, 0.0)
                    try:
                        self.solve()
                        known = np.vstack([known, self.points[-1:]])
                    except _NothingThere:
                        low = 1.0
                if low > high:
                    raise _NothingThere
                box.stands_low[n, leg], box.stands_high[n, leg] = low, high
                self.solver.changeRowBounds(row, low, high)
                self.points = known
                stands = self.values(share)
                self.points = known[(stands > low - _FIXED) & (stands < high + _FIXED)]
