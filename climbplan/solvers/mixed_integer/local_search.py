"""Primal heuristic of spatial branch and bound: local search from points of relaxations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.sqp.method import SqpSolver

_STARTS = 3  # local searches that the same integers get once there is an incumbent


@dataclass
class Incumbent:
    """The best feasible point of a search, and the local searches that were run for it."""

    instance: Instance
    tolerance: float
    x: Array | None = None
    assignment: IntArray | None = None
    cost: float = np.inf
    num_starts: Counter[bytes] = field(default_factory=Counter)
    num_searches: int = 0
    solver: SqpSolver | None = None

    def search_locally(
        self,
        x: Array,
        assignment: IntArray,
        integers: Array | None = None,
        max_starts: float = _STARTS,
    ) -> bool:
        """Solve the local nonlinear program from a point with its integers fixed.

        Args:
            x: (n,) start.
            assignment: (C,) alternative of each choice, kept fixed.
            integers: (n,) point whose integer values are used instead of those of `x`.
            starts: Maximal number of local searches with the same integers.

        Returns:
            Whether a better incumbent was found.
        """
        instance = self.instance
        values = np.where(instance.integer, np.round(x if integers is None else integers), x)
        key = values[instance.integer].tobytes() + assignment.tobytes()
        if self.x is not None and self.num_starts[key] >= max_starts:
            return False
        self.num_starts[key] += 1
        self.num_searches += 1
        if self.solver is None:
            self.solver = SqpSolver(instance)
        solution = self.solver.solve(values, assignment, values, self.cost)
        if solution.x is None or not solution.feasible:
            return False
        return self.update_if_better(solution.x, assignment)

    def update_if_better(self, x: Array, assignment: IntArray) -> bool:
        """Accept a point if it is feasible and better than the incumbent; return whether it is."""
        instance = self.instance
        if instance.violation(x, assignment) > self.tolerance:
            return False
        cost = instance.objective(x)
        if cost >= self.cost:
            return False
        self.x, self.assignment, self.cost = x, assignment, cost
        return True
