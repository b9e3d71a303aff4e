"""The mixed-integer block: logic, regions and box dynamics, eq. (6.12a) with an L1 consensus.

Built once; targets, weights and bounds are changed in place. The L1 norm keeps it linear.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Literal

import highspy
import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.limms.consensus.box_rows import add_box
from climbplan.limms.consensus.columns import Columns, columns_of
from climbplan.limms.consensus.copies import Copy, Found, modes_of
from climbplan.limms.consensus.lengths import LENGTHS, Lengths
from climbplan.limms.consensus.logic_rows import add_logic
from climbplan.limms.consensus.module_rows import add_modules
from climbplan.limms.consensus.setting import FREE, LEAPS, Setting
from climbplan.program.linear_rows import LinearRows
from climbplan.solvers.highs.model import highs, rows_model, run_highs

GOAL = 1000.0  # [1/m] cost of what is missing to the goal
REACHED = 20.0  # cost of a plan that reaches it, more than all else together
WAY = 0.1  # [1/m] of ways of modules
LATCH = 0.02  # of a latched module in an interval
NEAR_GOAL = 1e-3  # [m] an answer worth keeping the integers of
SMOOTHING = 20_000  # iterations of the simplex method, integers frozen
ROUNDS = 20  # of planes across links that are too long, with one choice of integers
LAPS = 8  # choices of integers, each cut off by the planes of the one before
_PATIENCE = 1.0  # [s] with a heuristic of HiGHS after Ctrl-C
_UNBOUNDED = 2**31 - 1
EFFORT = 0.02  # [s^2/m] of accelerations of the box
RESTS = 0.1  # of an interval in which the box has not been picked up
UNITS = {  # of rows; those of choices have none
    **dict.fromkeys(("box.dynamics", "force.limit", "force.friction", "force.unattached"), "N"),
    **dict.fromkeys(("goal.reached", "clear.box", "clear.solids", "kinematics.points"), "m"),
    **dict.fromkeys(("latch.position", "latch.rotation", "ground.stand", "support.sides"), "m"),
    "latch.moment": "N m",
}

Kind = Literal["arms", "stand", "leap"]


class MixedInteger:
    """The block of one setting, held by HiGHS."""

    def __init__(self, setting: Setting) -> None:
        began = time.perf_counter()
        self.setting = setting
        self.rows = table = LinearRows(UNITS)
        self.columns: Columns = columns_of(setting, table)
        add_logic(setting, table, self.columns)
        add_box(setting, table, self.columns)
        add_modules(setting, table, self.columns)
        self._costs(table)
        self.stated_columns, self.stated_rows = len(table.lower), len(table)  # before the consensus
        self._pulled = np.concatenate([self.columns.position.ravel(), self.columns.points.ravel()])
        self._away = table.columns((len(self._pulled),), 0.0, np.inf).astype(np.int32)
        # away >= x - target and away >= target - x
        self._first_row = self.stated_rows
        for sign in (-1.0, 1.0):
            table.block("consensus", ((self._away, 1.0), (self._pulled, sign)), -np.inf, np.inf)
        self._cost, self._lower, self._upper = map(np.array, (table.cost, table.lower, table.upper))
        self._binary = np.flatnonzero(table.integer).astype(np.int32)
        self._solver: Any = highs(gap=1e-3)
        # Tight tolerances are for proofs; the next consensus moves this answer anyway
        self._solver.setOptionValue("primal_feasibility_tolerance", 1e-7)
        self._solver.setOptionValue("mip_feasibility_tolerance", 1e-6)
        self._solver.passModel(rows_model(table))
        self._frozen = False
        self._lengths = Lengths(setting, self.columns.points, self._solver)
        self._kind: Kind = self.kinds[0]
        self.build_seconds = time.perf_counter() - began
        self.variables = len(self._cost)
        self.binaries = int((self._upper > self._lower)[self._binary].sum())
        self.constraints = len(table)

    def pull(self, target: Copy, weight: float) -> None:
        """Set the consensus term: weight |x - target| for every coordinate."""
        values = np.concatenate([target.box.ravel(), target.points.ravel()])
        count = len(values)
        rows = np.arange(self._first_row, self._first_row + 2 * count, dtype=np.int32)
        lower = np.concatenate([-values, values])
        upper = np.full(2 * count, np.inf)
        self._solver.changeRowsBounds(2 * count, rows, lower, upper)
        self._solver.changeColsCost(count, self._away, np.full(count, weight))
        # An answer near the goal is not enough any more: it has to be near the target
        self._solver.setOptionValue("objective_target", -np.inf)

    def rest(self) -> None:
        """Without a consensus, integers free: as at first, but for what was forbidden."""
        count = len(self._away)
        rows = np.arange(self._first_row, self._first_row + 2 * count, dtype=np.int32)
        self._solver.changeRowsBounds(
            2 * count, rows, np.full(2 * count, -np.inf), np.full(2 * count, np.inf)
        )
        self._solver.changeColsCost(count, self._away, np.zeros(count))
        if self._frozen:
            self._release()

    @property
    def kinds(self) -> list[Kind]:
        """What is left to choose between."""
        legs, leaps = self.columns.legs[0], self.columns.box[LEAPS, 0]
        found: list[Kind] = ["arms"] if self._lower[legs] == 0 else []
        if self._upper[legs] > 0:
            found.append("stand")
            if self._upper[leaps] > 0:
                found.append("leap")
        return found

    def choose(self, kind: Kind) -> None:
        """Only plans in which the box is held or thrown, stands on legs, or leaps on them."""
        self._kind = kind
        legs = int(self.columns.legs[0])
        value = float(kind != "arms")
        self._solver.changeColBounds(legs, value, value)
        for column in self.columns.box[LEAPS]:
            most = self._upper[column] if kind == "leap" else 0.0
            self._solver.changeColBounds(int(column), 0.0, float(most))

    def freeze(self, x: Array) -> None:
        """Keep the integers of an answer; what is left is a linear program."""
        values = np.round(x[self._binary])
        count = len(values)
        kinds = [highspy.HighsVarType.kContinuous] * count
        self._solver.changeColsIntegrality(count, self._binary, kinds)
        self._solver.changeColsBounds(count, self._binary, values, values)
        self._frozen = True
        for column in self.columns.missed:  # the goal stays reached
            self._solver.changeColBounds(int(column), 0.0, float(x[column]) + 1e-6)

    def _release(self) -> None:
        """Let the integers go again."""
        count = len(self._binary)
        kinds = [highspy.HighsVarType.kInteger] * count
        self._solver.changeColsIntegrality(count, self._binary, kinds)
        self._solver.changeColsBounds(
            count, self._binary, self._lower[self._binary], self._upper[self._binary]
        )
        self.choose(self._kind)
        self._frozen = False
        for column in self.columns.missed:
            self._solver.changeColBounds(int(column), 0.0, np.inf)

    def forbid(self, x: Array) -> None:
        """Cut off the hands of an answer: the same arms, or the same feet at the same times."""
        c, on = self.columns, x > 0.5
        if on[c.legs[0]]:
            used = np.concatenate([v[on[v]] for v in (c.box, c.ground, c.mount)])
            self._solver.addRow(
                -np.inf, float(len(used) - 1), len(used), used.astype(np.int32), np.ones(len(used))
            )
            return
        used = np.concatenate(
            [c.ever[on[c.hold].any(axis=-1)], c.wall[..., -1][on[c.wall[..., -1]]]]
        )
        free = int(on[c.box[FREE]].any())
        # With a flight where there was none, and the other way round, it is something else
        flight = c.box[FREE, -1]
        columns = np.append(used, flight).astype(np.int32)
        values = np.append(np.ones(len(used)), 1.0 if free else -1.0)
        self._solver.addRow(-np.inf, float(len(used) - 1 + free), len(columns), columns, values)

    def loosen(self, name: str) -> None:
        """Let a block of rows, by its name, hold no more."""
        if name == LENGTHS:
            self._lengths.loosen()
        rows = self._rows_of(name)
        free = np.full(len(rows), np.inf)
        self._solver.changeRowsBounds(len(rows), rows, -free, free)

    def restore(self, name: str) -> None:
        """Let a loosened block hold again."""
        if name == LENGTHS:
            self._lengths.restore()
        rows = self._rows_of(name)
        lower, upper = self.rows.row_lower[rows], self.rows.row_upper[rows]
        self._solver.changeRowsBounds(len(rows), rows, lower, upper)

    def _rows_of(self, name: str) -> NDArray[np.int32]:
        names = self.rows.names
        return np.flatnonzero(names.block == names.names.index(name)).astype(np.int32)

    def first(self, looks: int, deadline: float = np.inf) -> Found:
        """A point that reaches the goal, or the proof that there is none; no consensus yet.

        looks: how often HiGHS may look up; deadline: `time.monotonic` [s], a cap. With a proof, the
        point that comes nearest of those seen.
        """
        spent = 0.0
        for _ in range(LAPS):
            found = self._reaching(looks, deadline)
            spent += found.seconds
            if found.x is None or found.missed > NEAR_GOAL or not self.setting.form.reach:
                break
            smooth = self._smooth(found.x, deadline)
            spent += smooth.seconds
            if smooth.x is not None:
                found = replace(smooth, status=found.status)
                break
        return replace(found, seconds=spent)

    def _smooth(self, x: Array, deadline: float) -> Found:
        """With the integers of a point, the smoothest one whose links are no longer than they are.

        The first point at hand is restless, and planes round balls let links be longer. Without a
        point, links cannot be short enough with these integers, and the cuts say so from now on.
        """
        spent = 0.0
        self.freeze(x)
        for _ in range(ROUNDS):
            smooth = self.solve(SMOOTHING, deadline)
            spent += smooth.seconds
            if smooth.x is None or not self._lengths.cut(smooth.x):
                break
        self._release()
        return replace(smooth, seconds=spent)

    def _reaching(self, looks: int, deadline: float) -> Found:
        """A point that reaches the goal, or what is left of the search for one."""
        self._solver.setOptionValue("objective_target", REACHED)
        found = self.solve(looks // 2, deadline)
        if found.missed > NEAR_GOAL and found.status != "infeasible":
            again = self._at_goal(looks // 2, deadline)
            spent = found.seconds + again.seconds
            if again.x is not None:
                found = replace(again, seconds=spent)
            elif again.status == "infeasible":
                found = replace(found, status="infeasible", seconds=spent)
        return found

    def _at_goal(self, looks: int, deadline: float) -> Found:
        """Any point that reaches the goal, or the proof that there is none: nothing else costs."""
        every = np.arange(len(self._cost), dtype=np.int32)
        self._solver.changeColsCost(len(every), every, np.zeros(len(every)))
        for column in self.columns.missed:
            self._solver.changeColBounds(int(column), 0.0, NEAR_GOAL / 2)
        found = self.solve(looks, deadline)
        self._solver.changeColsCost(len(every), every, self._cost)
        for column in self.columns.missed:
            self._solver.changeColBounds(int(column), 0.0, np.inf)
        return found

    def solve(self, most: int, deadline: float = np.inf, start: Array | None = None) -> Found:
        """The block's best point within its work; `start`: a point to begin from.

        most: how often HiGHS may look up; with frozen integers, iterations of the simplex method.
        deadline: `time.monotonic` [s] at which it stops where it is.

        Raises LimitReached where HiGHS does not stop there.
        """
        began = time.perf_counter()
        left = max(deadline - time.monotonic(), 0.1)
        self._solver.setOptionValue("time_limit", float(self._solver.getRunTime() + left))
        iterations = most if self._frozen else _UNBOUNDED
        self._solver.setOptionValue("simplex_iteration_limit", iterations)
        if start is not None and not self._frozen:
            solution = highspy.HighsSolution()
            solution.col_value = list(start)
            self._solver.setSolution(solution)
        looks = most if not self._frozen else np.inf
        run_highs(self._solver, looks, _PATIENCE, time.monotonic() + left)
        status = self._solver.getModelStatus()
        solution = self._solver.getSolution()
        info = self._solver.getInfo()
        has_point = info.primal_solution_status == 2
        spent = time.perf_counter() - began
        proved = status == highspy.HighsModelStatus.kInfeasible
        if not has_point:
            word = "infeasible" if proved else "limit"
            return Found(word, None, None, None, np.inf, spent, None)
        x = np.array(solution.col_value)
        word = "optimal" if status == highspy.HighsModelStatus.kOptimal else "limit"
        c = self.columns
        copy = Copy(x[c.position], x[c.points])
        return Found(
            word,
            copy,
            modes_of(self.setting, c, x),
            x[c.velocity],
            float(np.linalg.norm(copy.box[-1] - self.setting.scene.goal)),
            spent,
            x,
            self.rows.worst(x),
        )

    def _costs(self, table: LinearRows) -> None:
        c = self.columns
        for columns, cost in (
            (c.missed, GOAL),
            (c.moved, WAY),
            (c.effort, EFFORT),
            (c.arm, LATCH),
            (c.added, LATCH),
            (c.leg, LATCH),
            (c.box[:1], RESTS),
        ):
            for column in np.ravel(columns):
                table.cost[column] = cost
