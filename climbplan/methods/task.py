"""One instance on its way through a method: settings, what may be tried, and the best of it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from climbplan.errors import UsageError
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.learning.neighbours import NearestProblems
from climbplan.learning.strategy import Candidate
from climbplan.methods.envelope_rounds import (
    EnvelopeOptions,
)
from climbplan.methods.pinning import PINNED_SOLVERS, solve_candidate
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.admm import AdmmOptions
from climbplan.solvers.ipopt.instances import middle
from climbplan.solvers.result import SolverResult
from climbplan.spec.program.model import ProgramMethod, ProgramStart

Method = ProgramMethod
Start = ProgramStart

_NEIGHBOURS = {"mpcc": 3}
_LEAST_SHARE = 0.1  # [s] that a follow-up gets when the time is over


@dataclass(frozen=True)
class MethodSettings:
    """How a method goes about it; what a method does not use it ignores.

    candidates: of `pinned`, before those of the library. library: of `knn`, of `mpcc` with start
    `knn`, and of `pinned`.
    """

    solver: str | None = None  # micp, admm: highs, scip, gurobi; pinned, knn: ipopt, sqp, ...
    gap: float = 1e-4  # relative
    time_limit: float = 60.0  # [s] of one instance
    tolerance: float = 1e-6  # largest violation of any row, in its own unit
    start: Start | None = None  # of mpcc: manual if the problem states a guess, else zero
    neighbours: int | None = None  # sets of integers to try: 10, 3 for mpcc
    fallback: Method | None = "minlp-scip"  # of learned methods, where no candidate holds
    library: Library | None = None
    model: StrategyModel | None = None  # of learned methods; knn may have a library instead
    candidates: Sequence[Candidate] = ()
    envelopes: EnvelopeOptions = field(default_factory=EnvelopeOptions)
    admm: AdmmOptions = field(default_factory=lambda: AdmmOptions(freeze_after=2))


@dataclass(frozen=True)
class Task:
    """One instance of a problem on its way through a method."""

    problem: Problem
    theta: Theta
    instance: Instance
    settings: MethodSettings
    begin: float

    @property
    def left(self) -> float:
        """Time that is left [s], a little of it always."""
        return max(self.settings.time_limit - (time.perf_counter() - self.begin), _LEAST_SHARE)

    def guess(self) -> Array | None:
        """The problem's own start (n,)."""
        return self.problem.start_point(self.theta, middle(self.instance))

    def neighbours(self, method: Method) -> tuple[Candidate, ...]:
        """The nearest sets of integers in the library, each once."""
        library, count = self.settings.library, self.settings.neighbours
        if self.settings.model is not None and method != "mpcc":
            strategy = self._trained(self.settings.model, method).strategy()
            features = self.problem.feature_vector(self.theta)
            return tuple(strategy.candidates(features, count or _NEIGHBOURS.get(method, 10)))
        if library is None:
            raise UsageError(
                f"method {method!r} needs solved problems: give a library (a plan file of "
                f"`climbplan solve` over `sample`)"
            )
        features = self.problem.feature_vector(self.theta)
        library.require(self.problem.program, len(features))
        near = NearestProblems.of(library, "strategies")
        return tuple(near.candidates(features, count or _NEIGHBOURS.get(method, 10)))

    def _trained(self, model: StrategyModel, method: Method) -> StrategyModel:
        """The model, if it is one of this method and problem."""
        if method not in ("pinned", model.kind):
            raise UsageError(f"method {method!r} was given a model of kind {model.kind!r}")
        count = len(self.problem.feature_vector(self.theta))
        model.library.require(self.problem.program, count)
        return model

    def clusters(self) -> ClusterRanking:
        """Clusters of the model of `reduce`."""
        if self.settings.model is None:
            raise UsageError("method 'reduce' needs a trained model")
        return self._trained(self.settings.model, "reduce").clusters()


@dataclass(frozen=True)
class Outcome:
    result: SolverResult
    winner: str
    tried: int


def all_pinned(
    task: Task, candidates: Sequence[Candidate], origins: Mapping[int, str] | None = None
) -> Outcome:
    """origins: what reports call candidates that are no neighbours, by identity."""
    settings, solver = task.settings, task.settings.solver
    chosen = next((name for name in PINNED_SOLVERS if name == solver), None)
    if solver is not None and chosen is None:
        known = ", ".join(PINNED_SOLVERS)
        raise UsageError(f"pinned integers: no solver {solver!r}, expected one of {known}")
    tried: list[tuple[str, SolverResult]] = []
    for k, candidate in enumerate(candidates, 1):
        if tried and time.perf_counter() - task.begin > settings.time_limit:
            break
        result = solve_candidate(
            task.instance, candidate, chosen, settings.gap, task.left, settings.tolerance
        )
        tried.append(((origins or {}).get(id(candidate), origin_of(k, candidate)), result))
    return best(task, tried)


def origin_of(rank: int, candidate: Candidate) -> str:
    return f"neighbour {rank} (row {candidate.row})"


def best(task: Task, tried: Sequence[tuple[str, SolverResult]]) -> Outcome:
    """The cheapest answer, the last failure if there is none."""
    answers = [(r.objective, k) for k, (_, r) in enumerate(tried) if r.objective is not None]
    if not answers:
        last = tried[-1][1]
        return Outcome(last, "", len(tried))
    origin, result = tried[min(answers)[1]]
    return Outcome(result, origin, len(tried))
