"""Solve a staged program with IPOPT, compiled once or solved once; its rows judge the point."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.residuals import BlockResidual
from climbplan.program.staged_program import StagedProgram
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram, NlpPoint

FEASIBLE = 1e-6  # largest violation at which an answer counts as solved


@dataclass(frozen=True)
class StagedProgramAnswer:
    """The point at which IPOPT stopped, and its quality."""

    values: tuple[Array, ...]  # values of the outputs
    residuals: tuple[BlockResidual, ...]  # of every named block
    solved: bool
    optimal: bool  # whether it is solved and IPOPT reports local optimality
    message: str
    violation: float
    objective: float
    seconds: float
    build_seconds: float
    variables: int
    constraints: int
    iterations: int

    def figures(self) -> dict[str, Any]:
        """Return quality and size by name."""
        names = ("solved", "message", "violation", "objective", "variables", "constraints")
        return {name: vars(self)[name] for name in names}


@dataclass(frozen=True)
class CompiledStagedProgram:
    """IPOPT, and the statement from which it was compiled: parameters change, rows do not."""

    formulation: StagedProgram
    solver: IpoptProgram
    bounds: Bounds  # as stated

    def residuals(self, point: NlpPoint, bounds: Bounds | None = None) -> tuple[BlockResidual, ...]:
        """Return residuals of every named block at a point; `bounds` replaces the stated ones."""
        row_bounds = bounds or self.bounds
        return self.formulation.residuals(point.rows, (row_bounds.row_lower, row_bounds.row_upper))


def compile_staged_program(
    formulation: StagedProgram,
    settings: Mapping[str, Any],
    expand: bool = False,
    hessian: ca.Function | None = None,
    by_stage: bool = False,
) -> CompiledStagedProgram:
    """Compile a staged program with parameters for IPOPT; see `IpoptProgram` for the options.

    by_stage: whether derivatives are those of one knot of each stage, which all knots share.
    """
    problem = {"x": formulation.x, "p": formulation.p, "f": formulation.cost, "g": formulation.rows}
    derivatives = formulation.build_derivatives() if by_stage else None
    if derivatives is not None:  # without the rows, which the cost of a call of stages evaluates
        problem["f"], _ = derivatives.gradient(formulation.x, formulation.p)
    solver = IpoptProgram(formulation.name, problem, settings, expand, hessian, derivatives)
    return CompiledStagedProgram(
        formulation, solver, Bounds(*formulation.bounds, *formulation.row_bounds)
    )


def solve_staged_program(
    formulation: StagedProgram,
    outputs: Sequence[ca.MX],
    settings: Mapping[str, Any],
    began: float,
    deadline: float = np.inf,
    expand: bool = False,
) -> StagedProgramAnswer:
    """Solve a staged program without parameters.

    Args:
        formulation: The statement.
        outputs: Expressions to evaluate at the answer.
        settings: Options of IPOPT.
        began: Start of building by `time.perf_counter` [s].
        deadline: Time of `time.monotonic` [s].
        expand: Whether to use one expression graph instead of function calls.
    """
    program = compile_staged_program(formulation, settings, expand)
    build_end = time.perf_counter()
    point = program.solver.solve(formulation.start, [], program.bounds, deadline)
    residuals = program.residuals(point)
    worst = max(residuals, key=lambda block: block.residual)
    solved = worst.residual <= FEASIBLE  # whatever the solver says of optimality
    outputs_at_solution = ca.Function("read", [formulation.x], list(outputs))(point.v)
    worst_block = "" if solved else f" of {worst.name}"
    return StagedProgramAnswer(
        values=tuple(np.asarray(value) for value in outputs_at_solution),
        residuals=residuals,
        solved=solved,
        optimal=solved and point.success,
        message=f"{point.word}, {point.iterations} iterations, "
        f"violation {worst.residual:.1e}{worst_block}",
        violation=worst.residual,
        objective=point.objective,
        seconds=time.perf_counter() - build_end,
        build_seconds=build_end - began,
        variables=len(point.v),
        constraints=len(point.rows),
        iterations=point.iterations,
    )
