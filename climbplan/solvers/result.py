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
MAX_ZERO_COST = 1e-6  # largest cost that may count as zero
_LEAST_UNIT = 1e-200  # of changes of a cost
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
    gap: float | None  # `relative_gap`
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


def relative_gap(objective: float, bound: float, zero_cost: float | None = None) -> float:
    """Return (objective - bound) / max(|objective|, scale), 0 if they differ by rounding errors.

    Where the objective and its distance from the bound are at most `zero_cost`, both count as zero,
    and the gap is 0: a relative gap of a zero is never small. Smaller scales and rounding errors
    are fractions of it.
    """
    unit = 1.0
    if zero_cost is not None:
        if abs(objective) <= zero_cost and objective - bound <= zero_cost:
            return 0.0
        unit = zero_cost / MAX_ZERO_COST
    scale = max(abs(objective), unit * MIN_OBJECTIVE_SCALE)
    return max(0.0, objective - bound - unit * ROUNDING) / scale


def compute_zero_cost(instance: Instance) -> float:
    """Return the largest cost that counts as zero: one millionth of the least change of the cost.

    A change is that of one variable by 1, or by its range where that is less, with the others at
    rest where their products with it vanish. The value is at most `MAX_ZERO_COST`.
    """
    width = instance.upper - instance.lower
    step = np.where(instance.integer, 1.0, np.minimum(width, 1.0))
    curvature = np.abs(instance.P.diagonal())
    change = np.where(curvature > 0.0, 0.5 * curvature * step, np.abs(instance.q)) * step
    is_priced = ((curvature > 0.0) | (instance.q != 0.0)) & (width > 0.0)
    return MAX_ZERO_COST * max(float(change[is_priced].min(initial=1.0)), _LEAST_UNIT)


def compute_closing_bound(objective: float, gap: float, zero_cost: float) -> float:
    """Return the bound from which on an incumbent is optimal, which is below its objective.

    It is infinite without an incumbent, whose objective is infinite.
    """
    if objective == np.inf:
        return np.inf
    margin = gap * abs(objective)
    return objective - (max(margin, zero_cost) if abs(objective) <= zero_cost else margin)


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
            achieved_gap = relative_gap(objective, bound, compute_zero_cost(instance))
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
