"""The online half: candidates -> pinned program -> exact check -> next candidate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from climbplan.arrays import Array
from climbplan.learning.strategy import Candidate
from climbplan.methods.local import Local, local_method
from climbplan.program.instance import Instance
from climbplan.solvers.sqp.method import SqpOptions

Stop = Literal["first", "best"]
NONE = -1


@dataclass(frozen=True)
class Checked:
    """What an exact check says of a point."""

    passed: bool
    objective: float
    x: Array  # the point it says so of, which may have been cleaned
    word: str = ""  # which constraint fails


Check = Callable[[Instance, Array], Checked]


@dataclass(frozen=True)
class Tried:
    """The fate of one candidate."""

    candidate: Candidate
    word: str
    programs: int
    passed: bool
    objective: float  # infinite unless it passed
    seconds: float
    solver: str


@dataclass(frozen=True)
class PipelineOptions:
    """How many candidates are tried and what each goes through."""

    local: Local = "form"
    stop: Stop = "best"
    good_enough: float = -np.inf  # an answer that costs no more ends the search
    time_limit: float = np.inf  # [s] after which no further candidate is begun
    tolerance: float = 1e-6  # of convex programs and the default check, in the unit of the rows
    gap: float = 1e-4  # relative, of convex programs
    prune: bool = True  # give a candidate up once it costs more than the best one
    sqp: SqpOptions = field(default_factory=SqpOptions)


@dataclass(frozen=True)
class PipelineResult:
    """The best checked answer, and which candidate it came from."""

    x: Array | None
    objective: float  # infinite without an answer
    winner: int  # place among the candidates; NONE (-1) if there is no answer
    tried: tuple[Tried, ...]

    @property
    def solved(self) -> bool:
        """Whether a checked answer was found."""
        return self.x is not None


def exact_check(tolerance: float = 1e-6) -> Check:
    """The default check: no constraint of the instance is violated by more than the tolerance."""

    def check(instance: Instance, x: Array) -> Checked:
        violation = instance.violation(x)
        return Checked(
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

    Pruning compares the instance's objective with the check's best one: leave it out where a check
    counts costs otherwise.

    check: default `Instance.violation` within the tolerance of the options; its objective decides
    which candidate is best.
    """
    chosen = options or PipelineOptions()
    judge = check or exact_check(chosen.tolerance)
    begin = time.perf_counter()
    method = local_method(
        instance, chosen.local, chosen.sqp, chosen.gap, chosen.time_limit, chosen.tolerance
    )
    tried: list[Tried] = []
    best: Checked | None = None
    winner = NONE
    for place, candidate in enumerate(candidates):
        start = time.perf_counter()
        if start - begin > chosen.time_limit:
            break
        cutoff = best.objective if best is not None and chosen.prune else np.inf
        answer = method.solve(candidate, cutoff)
        verdict = judge(instance, answer.x) if answer.x is not None else None
        holds = verdict is not None and verdict.passed
        word = answer.word if holds or verdict is None else f"{answer.word}, {verdict.word}"
        cost = verdict.objective if verdict is not None and holds else np.inf
        spent = time.perf_counter() - start
        tried.append(Tried(candidate, word, answer.programs, holds, cost, spent, answer.solver))
        if verdict is not None and holds:
            if best is None or cost < best.objective:
                best, winner = verdict, place
            if chosen.stop == "first" or cost <= chosen.good_enough:
                break
    return PipelineResult(
        x=None if best is None else best.x,
        objective=np.inf if best is None else best.objective,
        winner=winner,
        tried=tuple(tried),
    )
