"""Online pipeline: candidate, program at its integers, exact check, next candidate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from climbplan.arrays import Array
from climbplan.learning.strategy import Candidate
from climbplan.methods.local import Local, create_local_method
from climbplan.program.instance import Instance
from climbplan.solvers.sqp.method import SqpOptions

Stop = Literal["first", "best"]
NONE = -1


@dataclass(frozen=True)
class CheckedPoint:
    """Result of an exact check of a point."""

    passed: bool
    objective: float
    x: Array  # the checked point, which may have been corrected
    word: str = ""  # the constraint that fails


Check = Callable[[Instance, Array], CheckedPoint]


@dataclass(frozen=True)
class CandidateResult:
    """Result of one candidate."""

    candidate: Candidate
    word: str
    programs: int
    passed: bool
    objective: float  # infinite unless it passed
    seconds: float
    solver: str


@dataclass(frozen=True)
class PipelineOptions:
    """Options of the pipeline: the number of candidates and their processing."""

    local: Local = "form"
    stop: Stop = "best"
    good_enough: float = -np.inf  # cost at which an answer ends the search
    time_limit: float = np.inf  # time after which no further candidate is started [s]
    tolerance: float = 1e-6  # of convex programs and the default check, in the unit of the rows
    gap: float = 1e-4  # relative, of convex programs
    prune: bool = True  # whether to stop a candidate once it costs more than the best one
    sqp: SqpOptions = field(default_factory=SqpOptions)


@dataclass(frozen=True)
class PipelineResult:
    """The best checked answer, and its candidate."""

    x: Array | None
    objective: float  # infinite without an answer
    winner: int  # index of the candidate; NONE (-1) if there is no answer
    tried: tuple[CandidateResult, ...]

    @property
    def solved(self) -> bool:
        """Return whether a checked answer was found."""
        return self.x is not None


def create_exact_check(tolerance: float = 1e-6) -> Check:
    """Create the default check: no constraint is violated by more than the tolerance."""

    def check(instance: Instance, x: Array) -> CheckedPoint:
        violation = instance.violation(x)
        return CheckedPoint(
            violation <= tolerance, instance.objective(x), x, f"violated by {violation:.2g}"
        )

    return check


def run_pipeline(
    instance: Instance,
    candidates: Iterable[Candidate],
    options: PipelineOptions | None = None,
    check: Check | None = None,
) -> PipelineResult:
    """Try candidates in order until one is good enough, or all of them.

    Pruning compares the instance's cost with the check's best one; disable it where a check
    computes costs in another way.

    Args:
        instance: The instance.
        candidates: Candidates in order.
        options: Options of the pipeline.
        check: Check of points, by default `Instance.violation`; its cost selects the best
            candidate.
    """
    chosen = options or PipelineOptions()
    judge = check or create_exact_check(chosen.tolerance)
    begin = time.perf_counter()
    method = create_local_method(
        instance, chosen.local, chosen.sqp, chosen.gap, chosen.time_limit, chosen.tolerance
    )
    tried: list[CandidateResult] = []
    best: CheckedPoint | None = None
    winner = NONE
    for index, candidate in enumerate(candidates):
        start = time.perf_counter()
        if start - begin > chosen.time_limit:
            break
        cutoff = best.objective if best is not None and chosen.prune else np.inf
        answer = method.solve(candidate, cutoff)
        verdict = judge(instance, answer.x) if answer.x is not None else None
        is_feasible = verdict is not None and verdict.passed
        message = (
            answer.word if is_feasible or verdict is None else f"{answer.word}, {verdict.word}"
        )
        cost = verdict.objective if verdict is not None and is_feasible else np.inf
        duration = time.perf_counter() - start
        tried.append(
            CandidateResult(
                candidate, message, answer.programs, is_feasible, cost, duration, answer.solver
            )
        )
        if verdict is not None and is_feasible:
            if best is None or cost < best.objective:
                best, winner = verdict, index
            if chosen.stop == "first" or cost <= chosen.good_enough:
                break
    return PipelineResult(
        x=None if best is None else best.x,
        objective=np.inf if best is None else best.objective,
        winner=winner,
        tried=tuple(tried),
    )
