"""Results of solvers of instances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance

Status = Literal["optimal", "feasible", "infeasible", "limit"]

FEASIBILITY = 1e-7  # largest violation of an incumbent, in the unit of the rows
INFEASIBLE_MESSAGE = "proved: no point satisfies all constraints"
MIN_OBJECTIVE_SCALE = 1e-9  # smallest scale of the objective in relative gaps
ROUNDING = 1e-10  # differences between objective and bound that count as rounding errors


@dataclass(frozen=True)
class KnownResult:
    """Result of a relaxed instance: its bound is valid, its choices may be feasible."""

    assignment: IntArray | None = None  # (C,)
    bound: float = -np.inf


class Proposal(Protocol):
    """Integers that may be good, such as those of a solved neighbour: `learning.Candidate`."""

    @property
    def values(self) -> Array:
        """Point (n,) of which only integers are read."""

    @property
    def alternatives(self) -> IntArray:
        """Chosen alternative of each choice (C,)."""

    @property
    def start(self) -> Array:
        """Start of a local search (n,)."""


@dataclass(frozen=True)
class SolverResult:
    """Incumbent, proof and effort of one solve.

    The status is one of

    - optimal: the required gap is proved; - feasible: a limit was reached, the incumbent is kept; -
    infeasible: proved; - limit: a limit was reached without an incumbent.
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
    """A solver's answer before it is checked."""

    x: Array | None
    bound: float
    infeasible: bool  # the solver claims that no point is feasible
    nodes: int
    time: float  # [s]
    solver: str
    log: tuple[str, ...] = ()
    assignment: IntArray | None = None  # the least violated alternatives if missing


def relative_gap(objective: float, bound: float) -> float:
    """Return (objective - bound) / max(|objective|, scale), 0 if they differ by rounding errors."""
    return max(0.0, objective - bound - ROUNDING) / max(abs(objective), MIN_OBJECTIVE_SCALE)


def judge_answer(instance: Instance, answer: Answer, gap: float, tolerance: float) -> SolverResult:
    """Return the result of an answer, with feasibility and objective computed from the instance.

    A point that violates a constraint by more than the tolerance is no incumbent.
    """
    x, bound, log = answer.x, answer.bound, answer.log
    assignment: IntArray | None = None
    objective: float | None = None
    achieved_gap: float | None = None
    status: Status = "infeasible" if answer.infeasible else "limit"
    if x is not None:
        assignment = answer.assignment
        assignment = instance.assignment(x) if assignment is None else assignment
        violation = instance.violation(x, assignment)
        if violation <= tolerance:
            objective = instance.objective(x)
            bound = min(bound, objective)
            achieved_gap = relative_gap(objective, bound)
            status = "optimal" if achieved_gap <= gap else "feasible"
        else:
            log = (*log, f"incumbent refused: it violates a constraint by {violation:.3g}")
            x, assignment, status = None, None, "limit"
    return SolverResult(
        status=status,
        x=x,
        assignment=assignment,
        objective=objective,
        bound=np.inf if status == "infeasible" else bound,
        gap=achieved_gap,
        nodes=answer.nodes,
        time=answer.time,
        solver=answer.solver,
        log=log,
    )
