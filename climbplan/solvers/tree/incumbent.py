"""The best feasible point of a search, and how assignments become points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.result import LEAST_OBJECTIVE, ROUNDING
from climbplan.solvers.tree.relaxation import Closed, Point, Relaxation

_ROUNDS = 100  # of ball cuts
_SHARE = 0.4  # of the tolerance is left to balls
_GAP_SHARE = 0.999  # of the gap is used, the rest is left to rounding


@dataclass(frozen=True)
class Incumbent:
    """A feasible point."""

    x: Array  # (n,)
    assignment: IntArray  # (C,)
    objective: float


class IncumbentStore:
    """Keeps the best point that the instance itself calls feasible."""

    def __init__(
        self, instance: Instance, relaxation: Relaxation, gap: float, tolerance: float
    ) -> None:
        self.instance, self.relaxation = instance, relaxation
        self.gap, self.tolerance = gap, tolerance
        self.best: Incumbent | None = None
        self._tried: set[bytes] = set()

    @property
    def objective(self) -> float:
        """Of the best point, infinite before there is one."""
        return np.inf if self.best is None else self.best.objective

    @property
    def cutoff(self) -> float:
        """A node with this bound cannot improve the best point by more than the gap."""
        if self.best is None:
            return np.inf
        margin = _GAP_SHARE * self.gap * max(abs(self.objective), LEAST_OBJECTIVE)
        return self.objective - max(margin, ROUNDING)

    def accept(self, z: Array, assignment: IntArray) -> bool:
        """Keep a point if it is feasible and better; whether it was kept."""
        x = self.relaxation.form.x(z)
        objective = self.instance.objective(x)
        if objective >= self.objective:
            return False
        if self.instance.violation(x, assignment) > self.tolerance:
            return False
        self.best = Incumbent(x, assignment.astype(np.int64), objective)
        return True

    def complete(self, assignment: IntArray, start: Point, late: Callable[[], bool]) -> bool:
        """Solve the convex problem of an assignment, once; whether it gave a better point."""
        key = assignment.tobytes()
        if key in self._tried:
            return False
        self._tried.add(key)
        masks = tuple(1 << int(r) for r in assignment)
        point = start
        for _ in range(_ROUNDS):
            bounds = self.relaxation.bounds(masks)
            # What is infeasible, or hardly better, need not be proved so.
            solved = self.relaxation.solve(*bounds, point, self.objective, prove=False)
            if isinstance(solved, Closed) or not solved.solved or late():
                return False
            point = solved
            if self.relaxation.cut_balls(point.z, _SHARE * self.tolerance).count == 0:
                return self.accept(point.z, assignment)
        return False
