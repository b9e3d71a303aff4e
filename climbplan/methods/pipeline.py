"""The online half: candidates -> pinned program -> exact check -> next candidate -> fallback."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from climbplan.learning.strategy import Candidate
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.solvers.ipopt.instances import solve_pinned
from climbplan.solvers.sqp.envelopes import EnvelopeSolver
from climbplan.solvers.sqp.method import SqpOptions, SqpSolver

Local = Literal["sqp", "ipopt", "envelopes"]
Stop = Literal["first", "best"]
FALLBACK = -1


@dataclass(frozen=True)
class LocalAnswer:
    """What a local method made of one candidate, before the exact check."""

    x: Array | None  # (N,) integers included
    word: str  # how it ended
    programs: int  # convex programs or iterations


class LocalMethod(Protocol):
    """Solves what is left of one instance when the integers are given."""

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        """A local solution of the candidate; may give up if it costs more than the cutoff."""


@dataclass(frozen=True)
class Checked:
    """What an exact check says of a point."""

    passed: bool
    objective: float
    x: Array  # the point it says so of, which may have been cleaned
    word: str = ""  # which constraint fails


Check = Callable[[Instance, Array], Checked]
Fallback = Callable[[Instance], Array | None]


@dataclass(frozen=True)
class Tried:
    """The fate of one candidate."""

    candidate: Candidate
    word: str
    programs: int
    passed: bool
    objective: float  # infinite unless it passed
    seconds: float


@dataclass(frozen=True)
class Stages:
    """Wall-clock time [s]."""

    prepare: float
    local: float
    check: float
    fallback: float


@dataclass(frozen=True)
class PipelineOptions:
    """How many candidates are tried and what each goes through."""

    local: Local = "sqp"
    stop: Stop = "best"
    enough: int = 10**9  # feasible candidates after which the best of them is taken
    good_enough: float = -np.inf  # an answer that costs no more ends the search
    time_limit: float = np.inf  # [s] after which no further candidate is begun
    tolerance: float = 1e-6  # of the default check, in the unit of the rows
    prune: bool = True  # give a candidate up once it costs more than the best one
    sqp: SqpOptions = field(default_factory=SqpOptions)


@dataclass(frozen=True)
class PipelineResult:
    """The best checked answer, and which candidate it came from."""

    x: Array | None
    objective: float  # infinite without an answer
    winner: int  # place among the candidates; FALLBACK (-1) for it, or if there is no answer
    tried: tuple[Tried, ...]
    seconds: Stages

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
    fallback: Fallback | None = None,
) -> PipelineResult:
    """Try candidates in order until enough of them pass the exact check.

    Pruning compares the instance's objective with the check's best one: leave it out where a check
    counts costs otherwise.

    check: default `Instance.violation` within the tolerance of the options; its objective decides
    which candidate is best. fallback: asked for a point if no candidate passes; the point is
    checked like all others.
    """
    chosen = options or PipelineOptions()
    judge = check or exact_check(chosen.tolerance)
    begin = time.perf_counter()
    method = local_method(instance, chosen)
    prepared = time.perf_counter() - begin
    tried: list[Tried] = []
    best: Checked | None = None
    winner, passed, local, checking, spare = FALLBACK, 0, 0.0, 0.0, 0.0
    for place, candidate in enumerate(candidates):
        start = time.perf_counter()
        if start - begin > chosen.time_limit:
            break
        cutoff = best.objective if best is not None and chosen.prune else np.inf
        answer = method.solve(candidate, cutoff)
        solved = time.perf_counter()
        verdict = judge(instance, answer.x) if answer.x is not None else None
        end = time.perf_counter()
        local += solved - start
        checking += end - solved
        holds = verdict is not None and verdict.passed
        word = answer.word if holds or verdict is None else f"{answer.word}, {verdict.word}"
        cost = verdict.objective if verdict is not None and holds else np.inf
        tried.append(Tried(candidate, word, answer.programs, holds, cost, end - start))
        if verdict is not None and holds:
            passed += 1
            if best is None or cost < best.objective:
                best, winner = verdict, place
            if chosen.stop == "first" or passed >= chosen.enough:
                break
            if cost <= chosen.good_enough:
                break
    if best is None and fallback is not None:
        start = time.perf_counter()
        x = fallback(instance)
        verdict = judge(instance, x) if x is not None else None
        best = verdict if verdict is not None and verdict.passed else None
        spare = time.perf_counter() - start
    return PipelineResult(
        x=None if best is None else best.x,
        objective=np.inf if best is None else best.objective,
        winner=winner,
        tried=tuple(tried),
        seconds=Stages(prepared, local, checking, spare),
    )


def local_method(instance: Instance, options: PipelineOptions) -> LocalMethod:
    """The local method of the options, made ready for an instance."""
    if options.local == "sqp":
        return _Sqp(SqpSolver(instance, options.sqp))
    if options.local == "envelopes":
        return _Envelopes(EnvelopeSolver(instance, options.sqp.backend))
    return _Ipopt(instance)


@dataclass(frozen=True)
class _Sqp:
    solver: SqpSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        found = self.solver.solve(candidate.values, candidate.alternatives, candidate.start, cutoff)
        x = found.x if found.feasible else None
        return LocalAnswer(x, found.ending, found.programs)


@dataclass(frozen=True)
class _Ipopt:
    instance: Instance

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        integer = self.instance.integer
        start = np.where(integer, np.round(candidate.values), candidate.start)
        point = solve_pinned(self.instance, start, candidate.alternatives)
        return LocalAnswer(np.where(integer, start, point.v), point.word, point.iterations)


@dataclass(frozen=True)
class _Envelopes:
    solver: EnvelopeSolver

    def solve(self, candidate: Candidate, cutoff: float) -> LocalAnswer:
        found = self.solver.solve(candidate.values, candidate.alternatives, candidate.start)
        return LocalAnswer(found.x, found.word, 1)
