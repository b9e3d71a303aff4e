"""IPOPT on a stated trajectory: its point, judged by the rows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.program.polytope import Array
from climbplan.program.residuals import BlockResidual
from climbplan.program.trajectory import Trajectory
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram

FEASIBLE = 1e-6  # largest violation of an answer that is used


@dataclass(frozen=True)
class TrajectoryAnswer:
    """Where IPOPT stopped, and what that is worth."""

    values: tuple[Array, ...]  # of the outputs
    residuals: tuple[BlockResidual, ...]  # of every named block
    solved: bool
    optimal: bool  # solved, and the solver says that nothing near is better
    message: str
    violation: float
    objective: float
    seconds: float
    build_seconds: float
    variables: int
    constraints: int

    def figures(self) -> dict[str, Any]:
        """All but values, residuals and `optimal`, by name."""
        apart = ("values", "residuals", "optimal")
        return {k: v for k, v in vars(self).items() if k not in apart}


def solve_trajectory(
    trajectory: Trajectory,
    outputs: Sequence[ca.MX],
    settings: Mapping[str, Any],
    began: float,
    deadline: float = np.inf,
    expand: bool = False,
) -> TrajectoryAnswer:
    """Solve what was stated, which has no parameters; outputs: what is read from the answer.

    settings: IPOPT's own. began: of building, by `perf_counter`; deadline: by `monotonic` [s].
    """
    x, rows = trajectory.x, trajectory.rows
    problem = {"x": x, "p": trajectory.p, "f": trajectory.cost, "g": rows}
    program = IpoptProgram(trajectory.name, problem, settings, expand)
    built = time.perf_counter()
    bounds = Bounds(*trajectory.bounds, *trajectory.row_bounds)
    point = program.solve(trajectory.start, [], bounds, deadline)
    residuals = trajectory.residuals(point.rows)
    worst = max(residuals, key=lambda block: block.residual)
    solved = worst.residual <= FEASIBLE  # whatever the solver says of optimality
    read = ca.Function("read", [x], list(outputs))(point.v)
    where = "" if solved else f" of {worst.name}"
    return TrajectoryAnswer(
        values=tuple(np.asarray(value) for value in read),
        residuals=residuals,
        solved=solved,
        optimal=solved and point.success,
        message=f"{point.word}, {point.iterations} iterations, "
        f"violation {worst.residual:.1e}{where}",
        violation=worst.residual,
        objective=point.objective,
        seconds=time.perf_counter() - built,
        build_seconds=built - began,
        variables=int(x.numel()),
        constraints=int(rows.numel()),
    )
