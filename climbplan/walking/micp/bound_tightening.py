"""Optimality-based bound tightening (OBBT) of a relaxation.

Each state, force and moment arm is minimised and maximised over the linear relaxation. The row of
the cutoff keeps only motions that may improve the incumbent, so that all of these are within the
tightened bounds, and so are their envelopes. Contacts are probed: two programs for each leg and
knot ask what holds if it stands, and whether it may swing. Programs whose range a stored solution
nearly attains are filtered out (Gleixner et al. 2017, Three enhancements for optimization-based
bound tightening).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import highspy
import numpy as np

from climbplan.arrays import Array
from climbplan.solvers.highs.model import build_rows_model
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.outer_approximation import (
    confirm_infeasible,
    create_lp_solver,
    solve_lp,
)
from climbplan.walking.micp.partitions import ArmPiece
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.micp.variable_bounds import VariableBounds
from climbplan.walking.task.task import ANGLES, POSITION

_SAFETY = 1e-5  # that bounds are widened by: more than the tolerance of the solver
_MIN_TIGHTENING = 0.02  # of a range, that a program has to be able to tighten it by
_FIXED = 1e-6  # width of a range that counts as a value
_PRIMAL = 4


def tighten_bounds(
    program: MixedIntegerRelaxation,
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
    first_knot: int = 0,
) -> VariableBounds | None:
    """Tighten the bounds of a relaxation by linear programs.

    Bounds that the time does not suffice for stay as they are.

    Args:
        program: The relaxation.
        seconds: Time limit [s].
        clock: Clock of the time limit [s].
        first_knot: Bounds of earlier knots are left as they are.

    Returns:
        The tightened bounds; None if the program is infeasible.
    """
    tightener = _BoundTightener(program, clock() + seconds, clock)
    try:
        if first_knot == 0:
            tightener.tighten_velocity_cost()
        else:
            tightener.clear_objective()
        tightener.tighten_total_forces(first_knot)
        tightener.tighten_legs(first_knot)
        tightener.tighten_states(first_knot)
    except _EmptyDomain:
        return None
    except _TimeLimitReached:
        pass
    return tightener.bounds


class _EmptyDomain(Exception):
    """The program has no solution."""


class _TimeLimitReached(Exception):
    """No time is left for another linear program."""


class _BoundTightener:
    """The linear relaxation of a program under changing objectives."""

    def __init__(
        self, program: MixedIntegerRelaxation, end: float, clock: Callable[[], float]
    ) -> None:
        """Load the relaxation into the solver; `end` is the time limit by the clock [s]."""
        self.program, self.end, self.clock = program, end, clock
        model = program.model
        self.columns = np.array([[c.column for c in row] for row in program.states])
        low, high = np.array(model.lower)[self.columns], np.array(model.upper)[self.columns]
        copies = {name: value.copy() for name, value in vars(program.bounds).items()}
        self.bounds = VariableBounds(**(copies | {"state_low": low, "state_high": high}))
        self.solver = create_lp_solver()
        self.solver.setOptionValue("presolve", "off")  # presolve would discard the basis
        self.solver.setOptionValue("simplex_strategy", _PRIMAL)  # costs change, rows do not
        self.solver.passModel(build_rows_model(model, relaxed=True))
        self.all_columns = np.arange(len(model.lower), dtype=np.int32)
        self.solutions = np.empty((0, len(model.lower)))  # that satisfy the current rows

    def minimise(self) -> float | None:
        """Minimise the current objective, and store the solution.

        Returns:
            The minimum; None if the solver does not find it.

        Raises:
            _Infeasible: if the program is infeasible.
            _TimeLimitReached: if no time is left.
        """
        seconds_left = self.end - self.clock()
        if seconds_left <= 0:
            raise _TimeLimitReached
        self.solver.setOptionValue("time_limit", self.solver.getRunTime() + seconds_left)
        status = solve_lp(self.solver)
        if status == highspy.HighsModelStatus.kInfeasible:
            if confirm_infeasible(self.solver):
                raise _EmptyDomain
            return None
        if status != highspy.HighsModelStatus.kOptimal:
            return None
        solution = np.array(self.solver.getSolution().col_value)
        self.solutions = np.vstack([self.solutions, solution])
        return float(self.solver.getInfo().objective_function_value)

    def tighten_range(self, expression: LinExpr, low: float, high: float) -> tuple[float, float]:
        """Minimise and maximise an expression with known bounds; return the tighter bounds."""
        columns = np.array(list(expression.terms), np.int32)
        factors, constant = np.array(list(expression.terms.values())), self.program.model.constant
        try:
            for sign in (1.0, -1.0):
                if self.is_nearly_attained(expression, low if sign > 0 else high, high - low):
                    continue
                self.solver.changeColsCost(len(columns), columns, sign * factors)
                minimum = self.minimise()
                if minimum is None:
                    continue
                end = sign * (minimum - constant) + expression.constant
                if sign > 0:
                    low = max(low, end - _SAFETY)
                else:
                    high = min(high, end + _SAFETY)
        finally:  # if it is infeasible as well: the next program has an objective of its own
            self.solver.changeColsCost(len(columns), columns, np.zeros(len(columns)))
        return low, max(high, low)

    def evaluate_at_solutions(self, expression: LinExpr) -> Array:
        """Return the values of an expression at all stored solutions."""
        columns = np.array(list(expression.terms), np.int64)
        values: Array = self.solutions[:, columns] @ np.array(list(expression.terms.values()))
        return values + expression.constant

    def is_nearly_attained(self, expression: LinExpr, end: float, width: float) -> bool:
        """Return whether a stored solution is so near to an end that tightening gains little."""
        if not np.isfinite(width) or not len(self.solutions):
            return False
        distance = np.abs(self.evaluate_at_solutions(expression) - end).min()
        return bool(distance <= _MIN_TIGHTENING * width)

    def clear_objective(self) -> None:
        """Set all costs of the solver to zero, as `tighten_range` needs them."""
        count = len(self.all_columns)
        self.solver.changeColsCost(count, self.all_columns, np.zeros(count))

    def tighten_velocity_cost(self) -> None:
        """Tighten the cost of velocities along x and y: the cutoff less all other costs.

        It clears the objective at its end.
        """
        program, count = self.program, len(self.all_columns)
        for k, columns in enumerate(program.velocity_cost_columns):
            cost = np.array(program.model.cost)
            cost[list(columns)] = 0.0
            self.solver.changeColsCost(count, self.all_columns, cost)
            other_costs = self.minimise()
            if other_costs is not None:
                left = max(program.cutoff - other_costs, 0.0) + float(
                    program.fixed_velocity_cost[k]
                )
                self.bounds.velocity_cost[k] = min(
                    self.bounds.velocity_cost[k], left + _SAFETY * program.cutoff
                )
        self.clear_objective()

    def tighten_states(self, first_knot: int = 0) -> None:
        """Tighten all states after a knot except positions along x and y."""
        low, high = self.bounds.state_low, self.bounds.state_high
        for n in range(first_knot + 1, len(low)):
            has_rotation = n <= self.program.num_rotation_knots
            for k in range(low.shape[1] if has_rotation else ANGLES.start):
                if high[n, k] - low[n, k] < _FIXED or k in range(12)[POSITION][:2]:
                    continue
                column = int(self.columns[n, k])
                if not np.isfinite(high[n, k] - low[n, k]):  # the last angular velocity is free
                    continue
                expression = LinExpr({column: 1.0})
                low[n, k], high[n, k] = self.tighten_range(expression, low[n, k], high[n, k])
                self.solver.changeColBounds(column, low[n, k], high[n, k])

    def tighten_total_forces(self, first_knot: int = 0) -> None:
        """Tighten the sums of all contact forces from a knot on."""
        program, bounds = self.program, self.bounds
        for n in range(first_knot, len(program.pieces)):
            legs = program.pieces[n]
            for k in range(3):
                force = sum_expressions(q.force[k] for leg in legs for q in leg)
                low, high = bounds.total_force_low[n, k], bounds.total_force_high[n, k]
                bounds.total_force_low[n, k], bounds.total_force_high[n, k] = self.tighten_range(
                    force, low, high
                )

    def tighten_legs(self, first_knot: int = 0) -> None:
        """Probe the contacts from a knot on, and tighten arms and forces of standing legs."""
        for n in range(first_knot, len(self.program.pieces)):
            for leg, pieces in enumerate(self.program.pieces[n]):
                if self.bounds.contact_high[n, leg] != 0.0:
                    self.probe_contact(n, leg, pieces)

    def probe_contact(self, n: int, leg: int, pieces: tuple[ArmPiece, ...]) -> None:
        """Probe one contact: tighten what holds if the leg stands, and fix it if it has to.

        Stored solutions are kept as far as they satisfy the rows of each program.

        Raises:
            _Infeasible: if the leg can neither stand nor swing.
        """
        bounds, row = self.bounds, int(self.program.contact_rows[n, leg])
        contact = sum_expressions(q.indicator for q in pieces)
        low, high = bounds.contact_low[n, leg], bounds.contact_high[n, leg]
        solutions, contacts = self.solutions, self.evaluate_at_solutions(contact)
        self.solver.changeRowBounds(row, 1.0, 1.0)
        self.solutions = solutions[contacts > 1.0 - _FIXED]
        num_reused = len(self.solutions)
        try:
            self.tighten_standing_leg(n, leg, pieces)
        except _EmptyDomain:
            high = 0.0
        solutions = np.vstack([solutions, self.solutions[num_reused:]])
        if high > 0.0 and low == 0.0 and not (contacts < _FIXED).any():
            self.solver.changeRowBounds(row, 0.0, 0.0)
            try:
                self.minimise()
                solutions = np.vstack([solutions, self.solutions[-1:]])
            except _EmptyDomain:
                low = 1.0
        if low > high:
            raise _EmptyDomain
        bounds.contact_low[n, leg], bounds.contact_high[n, leg] = low, high
        self.solver.changeRowBounds(row, low, high)
        self.solutions = solutions
        contacts = self.evaluate_at_solutions(contact)
        self.solutions = solutions[(contacts > low - _FIXED) & (contacts < high + _FIXED)]

    def tighten_standing_leg(self, n: int, leg: int, pieces: tuple[ArmPiece, ...]) -> None:
        """Tighten the normal force of a leg, and its horizontal arm after the first knot."""
        bounds = self.bounds
        force = sum_expressions(q.force[2] for q in pieces)
        ends = bounds.force_low[n, leg, 2], bounds.force_high[n, leg, 2]
        bounds.force_low[n, leg, 2], bounds.force_high[n, leg, 2] = self.tighten_range(force, *ends)
        for k in range(2 if n else 0):
            arm = sum_expressions(q.arm[k] for q in pieces)
            ends = bounds.arm_low[n, leg, k], bounds.arm_high[n, leg, k]
            bounds.arm_low[n, leg, k], bounds.arm_high[n, leg, k] = self.tighten_range(arm, *ends)
