"""What every solver of an instance returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance

Status = Literal["optimal", "feasible", "infeasible", "limit"]

FEASIBILITY = 1e-7  # largest violation of an incumbent, in the unit of the rows
LEAST_OBJECTIVE = 1e-9  # gaps are relative to the objective, but not to less than this
ROUNDING = 1e-10  # differences between objective and bound that mean nothing


@dataclass(frozen=True)
class Known:
    """What a laxer instance of the same choices has told: its bound holds, its choices may do."""

    assignment: IntArray | None = None  # (C,)
    bound: float = -np.inf


class Proposal(Protocol):
    """Integers that may be good, such as those of a solved neighbour: `learning.Candidate`."""

    @property
    def values(self) -> Array:
        """(n,) of which only integers are read."""

    @property
    def alternatives(self) -> IntArray:
        """(C,) chosen alternative of each choice."""

    @property
    def start(self) -> Array:
        """(n,) where a local search may begin."""


@dataclass(frozen=True)
class SolverResult:
    """Incumbent, proof and effort of one solve.

    optimal: the gap asked for is proved. feasible: a limit was hit, the incumbent is kept.
    infeasible: proved. limit: a limit was hit before any incumbent.
    """

    status: Status
    x: Array | None  # (n,) incumbent
    assignment: IntArray | None  # (C,) chosen alternative of each choice
    objective: float | None  # exact objective at x
    bound: float  # valid lower bound on the optimum, -inf if none is known
    gap: float | None  # (objective - bound) / max(|objective|, LEAST_OBJECTIVE)
    nodes: int
    time: float  # [s] wall clock, without imports
    solver: str
    log: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """What a solver says, before it is checked."""

    x: Array | None
    bound: float
    infeasible: bool  # the solver claims that no point is feasible
    nodes: int
    time: float  # [s]
    solver: str
    log: tuple[str, ...] = ()
    assignment: IntArray | None = None  # the least violated alternatives if left out


def relative_gap(objective: float, bound: float) -> float:
    """(objective - bound) / max(|objective|, LEAST_OBJECTIVE), 0 if they differ by rounding."""
    return max(0.0, objective - bound - ROUNDING) / max(abs(objective), LEAST_OBJECTIVE)


def judged(instance: Instance, answer: Answer, gap: float, tolerance: float) -> SolverResult:
    """The result of an answer, feasibility and objective computed from the instance.

    A point that violates a constraint by more than the tolerance is no incumbent.
    """
    x, bound, log = answer.x, answer.bound, answer.log
    assignment: IntArray | None = None
    objective: float | None = None
    reached: float | None = None
    status: Status = "infeasible" if answer.infeasible else "limit"
    if x is not None:
        assignment = answer.assignment
        assignment = instance.assignment(x) if assignment is None else assignment
        violation = instance.violation(x, assignment)
        if violation <= tolerance:
            objective = instance.objective(x)
            bound = min(bound, objective)
            reached = relative_gap(objective, bound)
            status = "optimal" if reached <= gap else "feasible"
        else:
            log = (*log, f"incumbent refused: it violates a constraint by {violation:.3g}")
            x, assignment, status = None, None, "limit"
    return SolverResult(
        status=status,
        x=x,
        assignment=assignment,
        objective=objective,
        bound=np.inf if status == "infeasible" else bound,
        gap=reached,
        nodes=answer.nodes,
        time=answer.time,
        solver=answer.solver,
        log=log,
    )
