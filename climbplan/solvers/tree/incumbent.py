"""The best feasible point of a search, and points from assignments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.solvers.result import MIN_OBJECTIVE_SCALE, ROUNDING
from climbplan.solvers.tree.relaxation import ClosedRelaxation, RelaxationPoint, RelaxationSolver

_ROUNDS = 100  # largest number of rounds of ball cuts
_BALL_TOLERANCE_FRACTION = 0.4  # fraction of the tolerance for balls
_GAP_FRACTION = 0.999  # fraction of the gap that is used, as a margin for rounding


@dataclass(frozen=True)
class FeasiblePoint:
    """A feasible point and its cost."""

    x: Array  # (n,)
    assignment: IntArray  # (C,)
    objective: float


class IncumbentStore:
    """Keeps the best point that the instance itself calls feasible."""

    def __init__(
        self, instance: Instance, relaxation: RelaxationSolver, gap: float, tolerance: float
    ) -> None:
        """Begin without an incumbent."""
        self.instance, self.relaxation = instance, relaxation
        self.gap, self.tolerance = gap, tolerance
        self.best: FeasiblePoint | None = None
        self._tried: set[bytes] = set()

    @property
    def objective(self) -> float:
        """Cost of the best point, infinite without one."""
        return np.inf if self.best is None else self.best.objective

    @property
    def cutoff(self) -> float:
        """Bound from which a node cannot improve the best point by more than the gap."""
        if self.best is None:
            return np.inf
        margin = _GAP_FRACTION * self.gap * max(abs(self.objective), MIN_OBJECTIVE_SCALE)
        return self.objective - max(margin, ROUNDING)

    def accept(self, z: Array, assignment: IntArray) -> bool:
        """Keep a point if it is feasible and better; return whether it was kept."""
        x = self.relaxation.form.recover_x(z)
        objective = self.instance.objective(x)
        if objective >= self.objective:
            return False
        if self.instance.violation(x, assignment) > self.tolerance:
            return False
        self.best = FeasiblePoint(x, assignment.astype(np.int64), objective)
        return True

    def solve_assignment(
        self, assignment: IntArray, start: RelaxationPoint, is_late: Callable[[], bool]
    ) -> bool:
        """Solve the convex problem of an assignment, once; return whether it gave a better one."""
        key = assignment.tobytes()
        if key in self._tried:
            return False
        self._tried.add(key)
        masks = tuple(1 << int(r) for r in assignment)
        point = start
        for _ in range(_ROUNDS):
            bounds = self.relaxation.compute_bounds(masks)
            # Infeasible or hardly better assignments need no proof.
            solved = self.relaxation.solve(*bounds, point, self.objective, prove=False)
            if isinstance(solved, ClosedRelaxation) or not solved.solved or is_late():
                return False
            point = solved
            if (
                self.relaxation.cut_balls(point.z, _BALL_TOLERANCE_FRACTION * self.tolerance).count
                == 0
            ):
                return self.accept(point.z, assignment)
        return False
