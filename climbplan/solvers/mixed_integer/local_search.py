"""The best point of a search with products: what its nodes propose, made feasible nearby."""

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
    """The best point that was found, and what was tried for it."""

    instance: Instance
    tolerance: float
    x: Array | None = None
    assignment: IntArray | None = None
    cost: float = np.inf
    tried: Counter[bytes] = field(default_factory=Counter)
    searches: int = 0
    solver: SqpSolver | None = None

    def look(
        self,
        x: Array,
        assignment: IntArray,
        integers: Array | None = None,
        starts: float = _STARTS,
    ) -> bool:
        """A local search from a point (n,) with its integers kept; True if that found a better.

        integers: (n,) those of another point. starts: that these integers get.
        """
        instance = self.instance
        values = np.where(instance.integer, np.round(x if integers is None else integers), x)
        key = values[instance.integer].tobytes() + assignment.tobytes()
        if self.x is not None and self.tried[key] >= starts:
            return False
        self.tried[key] += 1
        self.searches += 1
        if self.solver is None:
            self.solver = SqpSolver(instance)
        found = self.solver.solve(values, assignment, values, self.cost)
        if found.x is None or not found.feasible:
            return False
        return self.take(found.x, assignment)

    def take(self, x: Array, assignment: IntArray) -> bool:
        """Whether a point is feasible and better than the best so far, which it then is."""
        instance = self.instance
        if instance.violation(x, assignment) > self.tolerance:
            return False
        cost = instance.objective(x)
        if cost >= self.cost:
            return False
        self.x, self.assignment, self.cost = x, assignment, cost
        return True
