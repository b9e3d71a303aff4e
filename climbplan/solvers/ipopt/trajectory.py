"""IPOPT on a stated trajectory: compiled once, or solved once; its point is judged by the rows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.residuals import BlockResidual
from climbplan.program.trajectory import Trajectory
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram, NlpPoint

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
    iterations: int

    def figures(self) -> dict[str, Any]:
        """What it is worth and how large it was, by name."""
        kept = ("solved", "message", "violation", "objective", "variables", "constraints")
        return {name: vars(self)[name] for name in kept}


@dataclass(frozen=True)
class CompiledTrajectory:
    """IPOPT, and the statement that it was compiled from: numbers change, rows do not."""

    stated: Trajectory
    solver: IpoptProgram
    bounds: Bounds  # as stated

    def residuals(self, point: NlpPoint, bounds: Bounds | None = None) -> tuple[BlockResidual, ...]:
        """Of every named block where IPOPT stopped; bounds: those it was given."""
        given = bounds or self.bounds
        return self.stated.residuals(point.rows, (given.row_lower, given.row_upper))


def compiled(
    stated: Trajectory,
    settings: Mapping[str, Any],
    expand: bool = False,
    hessian: ca.Function | None = None,
) -> CompiledTrajectory:
    """IPOPT for a statement with parameters. settings: IPOPT's own; the others as its program's."""
    problem = {"x": stated.x, "p": stated.p, "f": stated.cost, "g": stated.rows}
    solver = IpoptProgram(stated.name, problem, settings, expand, hessian)
    return CompiledTrajectory(stated, solver, Bounds(*stated.bounds, *stated.row_bounds))


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
    program = compiled(trajectory, settings, expand)
    built = time.perf_counter()
    point = program.solver.solve(trajectory.start, [], program.bounds, deadline)
    residuals = program.residuals(point)
    worst = max(residuals, key=lambda block: block.residual)
    solved = worst.residual <= FEASIBLE  # whatever the solver says of optimality
    read = ca.Function("read", [trajectory.x], list(outputs))(point.v)
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
        variables=len(point.v),
        constraints=len(point.rows),
        iterations=point.iterations,
    )
