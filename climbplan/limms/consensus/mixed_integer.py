"""The mixed-integer block: logic, regions and box dynamics, eq. (6.12a) with an L1 consensus.

It is a mixed-integer linear program, since the L1 norm keeps the consensus term linear. The model
is built once; targets, weights and bounds change in place.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Literal

import highspy
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.limms.consensus.block_solution import BlockSolution, LocalCopy, decode_modes
from climbplan.limms.consensus.box_rows import add_box_rows
from climbplan.limms.consensus.link_cuts import LENGTH_ROWS, LinkLengthCuts
from climbplan.limms.consensus.logic_rows import add_logic_rows
from climbplan.limms.consensus.module_rows import add_module_rows
from climbplan.limms.consensus.problem import FREE, LEAPS, ConsensusProblem
from climbplan.limms.consensus.variables import VariableColumns, add_variables
from climbplan.program.linear_rows import LinearRows
from climbplan.solvers.highs.model import build_rows_model, create_highs, run_highs

GOAL_WEIGHT = 1000.0  # [1/m] of the distance to the goal
GOAL_OBJECTIVE = 20.0  # above the objective of every plan that reaches the goal
PATH_WEIGHT = 0.1  # [1/m] of path lengths of modules
LATCH_WEIGHT = 0.02  # of a latched module in an interval
GOAL_TOLERANCE = 1e-3  # [m] within which integers are worth fixing
MAX_SIMPLEX_ITERATIONS = 20_000  # with fixed integers
MAX_CUT_ROUNDS = 20  # rounds of link-length cuts with one choice of integers
MAX_MODE_RETRIES = 8  # choices of integers, each excluded by the cuts of the last
_PATIENCE = 1.0  # [s] for HiGHS to stop after Ctrl-C
_UNBOUNDED = 2**31 - 1
EFFORT_WEIGHT = 0.02  # [s^2/m] of accelerations of the box
IDLE_WEIGHT = 0.1  # of an interval before the box is picked up
UNITS = {  # of rows; rows of integer choices have none
    **dict.fromkeys(
        ("box.dynamics", "force.limit", "force.friction", "force.without_contact"), "N"
    ),
    **dict.fromkeys(
        ("goal.position", "box.collision", "limbs.collision", "kinematics.forward"), "m"
    ),
    **dict.fromkeys(("latch.position", "latch.rotation", "ground.contact", "support.sides"), "m"),
    "latch.moment": "N m",
}

Behaviour = Literal["arms", "stand", "leap"]


class MixedIntegerBlock:
    """The mixed-integer block of one problem, in a persistent HiGHS model."""

    def __init__(self, problem: ConsensusProblem) -> None:
        start_time = time.perf_counter()
        self.problem = problem
        self.rows = table = LinearRows(UNITS)
        self.columns: VariableColumns = add_variables(problem, table)
        add_logic_rows(problem, table, self.columns)
        add_box_rows(problem, table, self.columns)
        add_module_rows(problem, table, self.columns)
        self._set_costs(table)
        self.num_columns, self.num_rows = len(table.lower), len(table)  # without the consensus term
        self._consensus_columns = np.concatenate(
            [self.columns.position.ravel(), self.columns.points.ravel()]
        )
        self._deviation_columns = table.columns(
            (len(self._consensus_columns),), 0.0, np.inf
        ).astype(np.int32)
        # deviation >= x - target and deviation >= target - x
        self._first_row = self.num_rows
        for sign in (-1.0, 1.0):
            table.block(
                "consensus",
                ((self._deviation_columns, 1.0), (self._consensus_columns, sign)),
                -np.inf,
                np.inf,
            )
        self._cost, self._lower, self._upper = map(np.array, (table.cost, table.lower, table.upper))
        self._binary = np.flatnonzero(table.integer).astype(np.int32)
        self._solver: Any = create_highs(gap=1e-3)
        # Tight tolerances are for proofs; the consensus moves this solution anyway
        self._solver.setOptionValue("primal_feasibility_tolerance", 1e-7)
        self._solver.setOptionValue("mip_feasibility_tolerance", 1e-6)
        self._solver.passModel(build_rows_model(table))
        self._has_fixed_integers = False
        self._lengths = LinkLengthCuts(problem, self.columns.points, self._solver)
        self._behaviour: Behaviour = self.behaviours[0]
        self.build_seconds = time.perf_counter() - start_time
        self.variables = len(self._cost)
        self.binaries = int((self._upper > self._lower)[self._binary].sum())
        self.constraints = len(table)

    def set_consensus_target(self, target: LocalCopy, weight: float) -> None:
        """Set the consensus term: weight |x - target| for every coordinate."""
        values = np.concatenate([target.box.ravel(), target.points.ravel()])
        count = len(values)
        rows = np.arange(self._first_row, self._first_row + 2 * count, dtype=np.int32)
        lower = np.concatenate([-values, values])
        upper = np.full(2 * count, np.inf)
        self._solver.changeRowsBounds(2 * count, rows, lower, upper)
        self._solver.changeColsCost(count, self._deviation_columns, np.full(count, weight))
        # A point near the goal no longer suffices: it has to be near the target
        self._solver.setOptionValue("objective_target", -np.inf)

    def clear_consensus(self) -> None:
        """Remove the consensus term and release the integers; no-good cuts stay."""
        count = len(self._deviation_columns)
        rows = np.arange(self._first_row, self._first_row + 2 * count, dtype=np.int32)
        self._solver.changeRowsBounds(
            2 * count, rows, np.full(2 * count, -np.inf), np.full(2 * count, np.inf)
        )
        self._solver.changeColsCost(count, self._deviation_columns, np.zeros(count))
        if self._has_fixed_integers:
            self._release_integers()

    @property
    def behaviours(self) -> list[Behaviour]:
        """The behaviours that the spec allows."""
        leg_column, leap_column = self.columns.uses_legs[0], self.columns.box[LEAPS, 0]
        behaviours: list[Behaviour] = ["arms"] if self._lower[leg_column] == 0 else []
        if self._upper[leg_column] > 0:
            behaviours.append("stand")
            if self._upper[leap_column] > 0:
                behaviours.append("leap")
        return behaviours

    def fix_behaviour(self, behaviour: Behaviour) -> None:
        """Restrict plans to a behaviour: the box is held or thrown, stands on legs, or leaps on
        them.
        """
        self._behaviour = behaviour
        leg_column = int(self.columns.uses_legs[0])
        value = float(behaviour != "arms")
        self._solver.changeColBounds(leg_column, value, value)
        for column in self.columns.box[LEAPS]:
            upper = self._upper[column] if behaviour == "leap" else 0.0
            self._solver.changeColBounds(int(column), 0.0, float(upper))

    def fix_integers(self, x: Array) -> None:
        """Fix the integers of a point; a linear program remains."""
        values = np.round(x[self._binary])
        count = len(values)
        types = [highspy.HighsVarType.kContinuous] * count
        self._solver.changeColsIntegrality(count, self._binary, types)
        self._solver.changeColsBounds(count, self._binary, values, values)
        self._has_fixed_integers = True
        for column in self.columns.goal_error:  # the goal remains reached
            self._solver.changeColBounds(int(column), 0.0, float(x[column]) + 1e-6)

    def _release_integers(self) -> None:
        """Release the fixed integers."""
        count = len(self._binary)
        types = [highspy.HighsVarType.kInteger] * count
        self._solver.changeColsIntegrality(count, self._binary, types)
        self._solver.changeColsBounds(
            count, self._binary, self._lower[self._binary], self._upper[self._binary]
        )
        self.fix_behaviour(self._behaviour)
        self._has_fixed_integers = False
        for column in self.columns.goal_error:
            self._solver.changeColBounds(int(column), 0.0, np.inf)

    def add_no_good_cut(self, x: Array) -> None:
        """Exclude the contacts of a point: the same arms, or the same feet at the same times."""
        c, is_one = self.columns, x > 0.5
        if is_one[c.uses_legs[0]]:
            ones = np.concatenate([v[is_one[v]] for v in (c.box, c.ground, c.mount)])
            self._solver.addRow(
                -np.inf, float(len(ones) - 1), len(ones), ones.astype(np.int32), np.ones(len(ones))
            )
            return
        ones = np.concatenate(
            [c.is_ever_held[is_one[c.hold].any(axis=-1)], c.wall[..., -1][is_one[c.wall[..., -1]]]]
        )
        has_flight = int(is_one[c.box[FREE]].any())
        # The same arms with a flight instead of none, or vice versa, are another choice
        flight_column = c.box[FREE, -1]
        columns = np.append(ones, flight_column).astype(np.int32)
        values = np.append(np.ones(len(ones)), 1.0 if has_flight else -1.0)
        self._solver.addRow(
            -np.inf, float(len(ones) - 1 + has_flight), len(columns), columns, values
        )

    def relax_rows(self, name: str) -> None:
        """Remove the bounds of a block of rows by its name."""
        if name == LENGTH_ROWS:
            self._lengths.relax()
        rows = self._find_rows(name)
        infinite = np.full(len(rows), np.inf)
        self._solver.changeRowsBounds(len(rows), rows, -infinite, infinite)

    def restore_rows(self, name: str) -> None:
        """Restore the bounds of a relaxed block of rows."""
        if name == LENGTH_ROWS:
            self._lengths.restore()
        rows = self._find_rows(name)
        lower, upper = self.rows.row_lower[rows], self.rows.row_upper[rows]
        self._solver.changeRowsBounds(len(rows), rows, lower, upper)

    def _find_rows(self, name: str) -> NDArray[np.int32]:
        """Return the indices of a block of rows."""
        names = self.rows.names
        return np.flatnonzero(names.block == names.names.index(name)).astype(np.int32)

    def find_feasible(self, callbacks: int, deadline: float = np.inf) -> BlockSolution:
        """Find a point that reaches the goal, or prove that there is none, without consensus.

        Args:
            callbacks: Number of limit checks that HiGHS may make.
            deadline: Time limit as `time.monotonic` [s].

        Returns:
            The point; with a proof of infeasibility, the nearest point found.
        """
        seconds = 0.0
        for _ in range(MAX_MODE_RETRIES):
            solution = self._search_goal(callbacks, deadline)
            seconds += solution.seconds
            if (
                solution.x is None
                or solution.goal_error > GOAL_TOLERANCE
                or not self.problem.formulation.has_kinematics
            ):
                break
            polished = self._polish(solution.x, deadline)
            seconds += polished.seconds
            if polished.x is not None:
                solution = replace(polished, status=solution.status)
                break
        return replace(solution, seconds=seconds)

    def _polish(self, x: Array, deadline: float) -> BlockSolution:
        """Minimise the cost with fixed integers and with link lengths as cuts.

        The first feasible point moves needlessly, and the fixed planes let links be too long.
        Without a solution, the integers admit no short enough links, and the cuts exclude them from
        then on.
        """
        seconds = 0.0
        self.fix_integers(x)
        for _ in range(MAX_CUT_ROUNDS):
            polished = self.solve(MAX_SIMPLEX_ITERATIONS, deadline)
            seconds += polished.seconds
            if polished.x is None or not self._lengths.add_cuts(polished.x):
                break
        self._release_integers()
        return replace(polished, seconds=seconds)

    def _search_goal(self, callbacks: int, deadline: float) -> BlockSolution:
        """Search a point that reaches the goal; return the best one if there is none."""
        self._solver.setOptionValue("objective_target", GOAL_OBJECTIVE)
        solution = self.solve(callbacks // 2, deadline)
        if solution.goal_error > GOAL_TOLERANCE and solution.status != "infeasible":
            goal_solution = self._find_goal_point(callbacks // 2, deadline)
            seconds = solution.seconds + goal_solution.seconds
            if goal_solution.x is not None:
                solution = replace(goal_solution, seconds=seconds)
            elif goal_solution.status == "infeasible":
                solution = replace(solution, status="infeasible", seconds=seconds)
        return solution

    def _find_goal_point(self, callbacks: int, deadline: float) -> BlockSolution:
        """Find any point that reaches the goal at zero cost, or prove that there is none."""
        columns = np.arange(len(self._cost), dtype=np.int32)
        self._solver.changeColsCost(len(columns), columns, np.zeros(len(columns)))
        for column in self.columns.goal_error:
            self._solver.changeColBounds(int(column), 0.0, GOAL_TOLERANCE / 2)
        solution = self.solve(callbacks, deadline)
        self._solver.changeColsCost(len(columns), columns, self._cost)
        for column in self.columns.goal_error:
            self._solver.changeColBounds(int(column), 0.0, np.inf)
        return solution

    def solve(
        self, work_limit: int, deadline: float = np.inf, start: Array | None = None
    ) -> BlockSolution:
        """Solve the block within its work limit.

        Args:
            work_limit: Number of limit checks of HiGHS; with fixed integers, simplex iterations.
            deadline: Time at which HiGHS stops, as `time.monotonic` [s].
            start: Initial point.

        Raises:
            LimitReached: HiGHS does not stop at the deadline.
        """
        start_time = time.perf_counter()
        remaining = max(deadline - time.monotonic(), 0.1)
        self._solver.setOptionValue("time_limit", float(self._solver.getRunTime() + remaining))
        iterations = work_limit if self._has_fixed_integers else _UNBOUNDED
        self._solver.setOptionValue("simplex_iteration_limit", iterations)
        if start is not None and not self._has_fixed_integers:
            highs_solution = highspy.HighsSolution()
            highs_solution.col_value = list(start)
            self._solver.setSolution(highs_solution)
        callbacks = work_limit if not self._has_fixed_integers else np.inf
        run_highs(self._solver, callbacks, _PATIENCE, time.monotonic() + remaining)
        status = self._solver.getModelStatus()
        highs_solution = self._solver.getSolution()
        info = self._solver.getInfo()
        has_point = info.primal_solution_status == 2
        seconds = time.perf_counter() - start_time
        is_infeasible = status == highspy.HighsModelStatus.kInfeasible
        if not has_point:
            status_name = "infeasible" if is_infeasible else "limit"
            return BlockSolution(status_name, None, None, None, np.inf, seconds, None)
        x = np.array(highs_solution.col_value)
        status_name = "optimal" if status == highspy.HighsModelStatus.kOptimal else "limit"
        c = self.columns
        copy = LocalCopy(x[c.position], x[c.points])
        return BlockSolution(
            status_name,
            copy,
            decode_modes(self.problem, c, x),
            x[c.velocity],
            float(np.linalg.norm(copy.box[-1] - self.problem.scene.goal)),
            seconds,
            x,
            self.rows.worst(x),
        )

    def _set_costs(self, table: LinearRows) -> None:
        """Set the objective: distance to the goal, paths, accelerations and latches."""
        c = self.columns
        for columns, cost in (
            (c.goal_error, GOAL_WEIGHT),
            (c.path_bound, PATH_WEIGHT),
            (c.abs_acceleration, EFFORT_WEIGHT),
            (c.arm, LATCH_WEIGHT),
            (c.added, LATCH_WEIGHT),
            (c.leg, LATCH_WEIGHT),
            (c.box[:1], IDLE_WEIGHT),
        ):
            for column in np.ravel(columns):
                table.cost[column] = cost
