"""The convex program that is left when all integers are given, by the solver of tree nodes."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.benders.cuts import Cut
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.numbers import MixedIntegerProgram
from climbplan.solvers.mixed_integer.search import rounded, settle
from climbplan.solvers.mixed_integer.tree_run import TreeRun

_LEAST = 1e-14  # multipliers below this share of the largest are rounding


class Subproblem:
    """One problem's rows, re-solved at one set of integers after the other."""

    def __init__(self, program: MixedIntegerProgram, tolerance: float) -> None:
        self._run = TreeRun.of(program, 0.0, tolerance)
        self.count = 0  # sets of integers

    @property
    def steps(self) -> int:
        """Dual steps so far."""
        return int(self._run.search.main.iterations[0])

    def relaxed(self) -> tuple[float, IntArray]:
        """A bound of all integers, infinite if none are feasible, and integers near its point."""
        n, search = self._run.program.numbers, self._run.search
        bound = self._settled(n.lowest, n.highest)
        integers = n.lowest.copy()
        if self._empty:
            return np.inf, integers
        rounded(n, search, n.lowest, n.highest, integers)
        return bound, integers

    def solve(self, integers: IntArray) -> tuple[Array | None, Cut | None]:
        """x (size,) and the cut; no x where the program is empty, no cut where it is not solved.

        Where rounding stopped the solver, x violates rows and the cut is what was proved by then.
        """
        self.count += 1
        program, search = self._run.program, self._run.search
        bound = self._settled(integers, integers)
        if np.isneginf(bound) and not self._empty:
            # Rounding got the better of the factors: once more from the beginning
            self._run.tree.active[0] = 0
            bound = self._settled(integers, integers)
        x = program.point(search.w, integers)
        w = search.main
        if self._empty:
            count = int(w.ray_count[0])
            return None, self._cut(w.ray_row[:count], w.ray_side[:count], w.ray[:count], x, False)
        if np.isneginf(bound):
            return None, None
        count = int(w.count[0])
        return x, self._cut(w.row[:count], w.side[:count], w.multiplier[:count], x, True)

    def _settled(self, low: IntArray, high: IntArray) -> float:
        tree, search = self._run.tree, self._run.search
        tree.low[0], tree.high[0] = low, high
        tree.bound[0], tree.state[0] = -np.inf, place.OPEN
        settle(self._run.program.numbers, search, tree, 0)
        return float(tree.bound[0])

    @property
    def _empty(self) -> bool:
        return bool(self._run.tree.state[0] == place.EMPTY_NODE)

    def _cut(self, row: IntArray, side: Array, multiplier: Array, x: Array, feasible: bool) -> Cut:
        program = self._run.program
        y = side * multiplier / program.numbers.norm[row]
        keep = np.abs(y) > _LEAST * np.abs(y).max(initial=0.0)
        y, key = y[keep], program.key[row[keep]]
        if not feasible:
            y = y / np.abs(y).max(initial=1e-300)
        return Cut(key, y, x, feasible)
