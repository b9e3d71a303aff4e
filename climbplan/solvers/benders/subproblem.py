"""Solve the convex subproblem for fixed integers with the solver of tree nodes."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.solvers.benders.benders_cuts import BendersCut
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram
from climbplan.solvers.mixed_integer.search import resolve_leaf, round_relaxation
from climbplan.solvers.mixed_integer.tree_run import TreeRun

_MIN_MULTIPLIER = 1e-14  # multipliers below this fraction of the largest are rounding errors


class Subproblem:
    """The rows of one problem, solved for one set of integers after the other."""

    def __init__(self, program: MixedIntegerProgram, tolerance: float) -> None:
        """Allocate a tree with a single node."""
        self._run = TreeRun.create(program, 0.0, tolerance)
        self.num_solved = 0  # number of sets of integers

    @property
    def num_dual_steps(self) -> int:
        """Number of dual steps so far."""
        return int(self._run.search.main.iterations[0])

    def solve_relaxation(self) -> tuple[float, IntArray]:
        """Solve the relaxation; return its bound, infinite if infeasible, and rounded integers."""
        n, search = self._run.program.data, self._run.search
        bound = self._solve_node(n.root_low, n.root_high)
        integers = n.root_low.copy()
        if self._is_infeasible:
            return np.inf, integers
        round_relaxation(n, search, n.root_low, n.root_high, integers)
        return bound, integers

    def solve(self, integers: IntArray) -> tuple[Array | None, BendersCut | None]:
        """Solve the subproblem of one set of integers.

        Where rounding errors stop the solver, x violates rows, and the cut is what was proved until
        then.

        Returns:
            x (size,), None where the subproblem is infeasible, and the cut, None where it is
            unsolved.
        """
        self.num_solved += 1
        program, search = self._run.program, self._run.search
        bound = self._solve_node(integers, integers)
        if np.isneginf(bound) and not self._is_infeasible:
            # The factors have lost accuracy: solve from scratch
            self._run.tree.active[0] = 0
            bound = self._solve_node(integers, integers)
        x = program.recover_point(search.w, integers)
        w = search.main
        if self._is_infeasible:
            count = int(w.ray_count[0])
            return None, self._build_cut(
                w.ray_row[:count], w.ray_side[:count], w.ray[:count], x, False
            )
        if np.isneginf(bound):
            return None, None
        count = int(w.count[0])
        return x, self._build_cut(w.row[:count], w.side[:count], w.multiplier[:count], x, True)

    def _solve_node(self, low: IntArray, high: IntArray) -> float:
        """Solve the node with these ranges of integers; return its bound."""
        tree, search = self._run.tree, self._run.search
        tree.low[0], tree.high[0] = low, high
        tree.bound[0], tree.state[0] = -np.inf, slots.OPEN
        resolve_leaf(self._run.program.data, search, tree, 0)
        return float(tree.bound[0])

    @property
    def _is_infeasible(self) -> bool:
        """Return whether the node that was solved last is infeasible."""
        return bool(self._run.tree.state[0] == slots.EMPTY_NODE)

    def _build_cut(
        self, row: IntArray, side: Array, multiplier: Array, x: Array, feasible: bool
    ) -> BendersCut:
        """Build a cut from multipliers, which are scaled to at most 1 for a ray."""
        program = self._run.program
        y = side * multiplier / program.data.norm[row]
        keep = np.abs(y) > _MIN_MULTIPLIER * np.abs(y).max(initial=0.0)
        y, key = y[keep], program.row_key[row[keep]]
        if not feasible:
            y = y / np.abs(y).max(initial=1e-300)
        return BendersCut(key, y, x, feasible)
