"""The answer to a program of unknowns: IPOPT's point, judged by its rows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.limms.scene import Array
from climbplan.limms.unknowns import Unknowns
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram

FEASIBLE = 1e-6  # largest violation of an answer that is used


@dataclass(frozen=True)
class ProgramAnswer:
    """Where IPOPT stopped, and what that is worth."""

    values: tuple[Array, ...]  # of the outputs
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
        """All but values and `optimal`, by name."""
        return {k: v for k, v in vars(self).items() if k not in ("values", "optimal")}


def solve_unknowns(
    name: str,
    unknowns: Unknowns,
    cost: ca.MX,
    outputs: Sequence[ca.MX],
    settings: Mapping[str, Any],
    began: float,
    deadline: float = np.inf,
    expand: bool = False,
) -> ProgramAnswer:
    """Solve for unknowns that were all added; outputs: what is read from the answer.

    settings: IPOPT's own. began: of building, by `perf_counter`; deadline: by `monotonic` [s].
    """
    x, g = ca.vertcat(*unknowns.x), ca.vertcat(*unknowns.g)
    problem = {"x": x, "p": ca.MX.sym("p", 0), "f": cost, "g": g}
    program = IpoptProgram(name, problem, settings, expand)
    built = time.perf_counter()
    low, high = np.concatenate(unknowns.g_low), np.concatenate(unknowns.g_high)
    bounds = Bounds(np.concatenate(unknowns.low), np.concatenate(unknowns.high), low, high)
    point = program.solve(np.concatenate(unknowns.start), [], bounds, deadline)
    violation = float(np.maximum(low - point.rows, point.rows - high).max())
    solved = violation <= FEASIBLE  # whatever the solver says of optimality
    read = ca.Function("read", [x], list(outputs))(point.v)
    return ProgramAnswer(
        values=tuple(np.asarray(value) for value in read),
        solved=solved,
        optimal=solved and point.success,
        message=f"{point.word}, {point.iterations} iterations, violation {violation:.1e}",
        violation=violation,
        objective=point.objective,
        seconds=time.perf_counter() - built,
        build_seconds=built - began,
        variables=int(x.numel()),
        constraints=int(g.numel()),
    )
