"""One instance in a method: settings, candidates, and the best answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, cast

import numpy as np

from climbplan.arrays import Array
from climbplan.certificates.certificate import Certificate
from climbplan.errors import UsageError
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.learning.neighbours import NearestProblems
from climbplan.learning.strategy import Candidate, Strategy
from climbplan.methods.candidate_solving import FIXED_INTEGER_SOLVERS
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.pipeline import (
    CandidateResult,
    Check,
    CheckedPoint,
    PipelineOptions,
    run_pipeline,
)
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.reformulations.complementarity import Complementarity
from climbplan.schema.program.model import ProgramMethod, ProgramStart
from climbplan.solvers.admm import AdmmOptions
from climbplan.solvers.ipopt.instances import compute_box_center
from climbplan.solvers.ipopt.mpcc import HOMOTOPY
from climbplan.solvers.result import Answer, SolverResult, judge_answer

Method = ProgramMethod
Start = ProgramStart

_MAX_CANDIDATES = 10  # sets of integers that are tried
MAX_ROOT_CANDIDATES = 20  # those tried at the root of the compiled tree, which costs little
_MIN_TIME = 0.1  # time for a follow-up after the time limit [s]
_Value = TypeVar("_Value")


@dataclass(frozen=True)
class MpccOptions:
    """Complementarity reformulations in the order in which they are tried, and the homotopy."""

    forms: tuple[Complementarity, ...] = (
        Complementarity("product"),
        Complementarity("fischer-burmeister"),
    )
    homotopy: tuple[float, ...] = HOMOTOPY


@dataclass(frozen=True)
class MethodSettings:
    """Settings of a method; settings that a method does not use are ignored.

    Candidates are those of `pinned`, before those of the library. The library is that of `knn`, of
    `mpcc` with start `knn`, and of `pinned`. The options in `pinned` apply to candidates; times,
    gaps and tolerances are those of the settings.
    """

    solver: str | None = None  # mccormick, admm: highs, scip, gurobi; pinned, knn: ipopt, sqp, ...
    gap: float = 1e-4  # relative
    time_limit: float = 60.0  # [s] of one instance
    tolerance: float = 1e-6  # largest violation of any row, in its own unit
    own_tolerance: float | None = None  # of the problem's own check, the same if left out
    start: Start | None = None  # of mpcc: manual if the problem states a guess, else zero
    work: int | None = None  # of a sequence: dual steps of one tree, which count the same each time
    certificate: bool = False  # branch-and-bound: a proof of the bound comes with the answer
    neighbours: int | None = None  # sets of integers to try: 10, 20 at the root, 3 for mpcc
    fallback: Method | None = "minlp-scip"  # of learned methods, where no candidate holds
    library: Library | None = None
    model: StrategyModel | None = None  # of learned methods; knn may have a library instead
    strategy: Strategy | None = None  # one's own, in place of library and model
    candidates: Sequence[Candidate] = ()
    pinned: PipelineOptions = field(default_factory=PipelineOptions)
    envelopes: EnvelopeOptions = field(default_factory=EnvelopeOptions)
    mpcc: MpccOptions = field(default_factory=MpccOptions)
    admm: AdmmOptions = field(default_factory=lambda: AdmmOptions(freeze_after=2))


class SharedCache:
    """Values that the instances of one problem share by one method."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def compute_once(self, name: str, compute: Callable[[], _Value]) -> _Value:
        """Return the value of a name, computed if it is missing."""
        if name not in self._values:
            self._values[name] = compute()
        return cast("_Value", self._values[name])


@dataclass(frozen=True)
class Task:
    """One instance of a problem in a method."""

    problem: Problem
    theta: Theta
    instance: Instance
    settings: MethodSettings
    begin: float
    kept: SharedCache = field(default_factory=SharedCache)

    @property
    def time_left(self) -> float:
        """Time left [s], always a little."""
        return max(self.settings.time_limit - (time.perf_counter() - self.begin), _MIN_TIME)

    @property
    def is_late(self) -> bool:
        """Return whether the time is over."""
        return time.perf_counter() - self.begin > self.settings.time_limit

    def compute_guess(self) -> Array | None:
        """Return the problem's own start (n,)."""
        return self.problem.start_point(self.theta, compute_box_center(self.instance))

    def explain_rejection(self, x: Array) -> str:
        """Return why the problem's own checker rejects a point (n,); empty if it passes."""
        own_tolerance = self.settings.own_tolerance
        limit = self.settings.tolerance if own_tolerance is None else own_tolerance
        violations = [
            f"{block.name.removeprefix('own.')} by {block.residual:.3g}"
            for block in self.problem.own_residuals(self.theta, x)
            if block.residual > limit
        ]
        return (
            f"answer refused by the problem's own check: {', '.join(violations)}"
            if violations
            else ""
        )

    def apply_own_check(self, result: SolverResult) -> SolverResult:
        """Return the result, without its answer if the problem's own checker rejects it."""
        rejection = "" if result.x is None else self.explain_rejection(result.x)
        if not rejection:
            return result
        log = (*result.log, rejection)
        return replace(
            result, status="limit", x=None, assignment=None, objective=None, gap=None, log=log
        )

    def check_point(self, instance: Instance, x: Array) -> CheckedPoint:
        """Check a point by the statement and by the problem's own checker."""
        cost = instance.objective(x)
        if np.isfinite(self.settings.tolerance):
            violation = instance.violation(x)
            if violation > self.settings.tolerance:
                return CheckedPoint(False, cost, x, f"violated by {violation:.2g}")
        rejection = self.explain_rejection(x)
        return CheckedPoint(not rejection, cost, x, rejection)

    def find_neighbours(
        self, method: Method, default_count: int = _MAX_CANDIDATES
    ) -> tuple[Candidate, ...]:
        """Return the nearest sets of integers, each once; with products also further starts."""
        strategy = self.kept.compute_once(
            f"strategy of {method}", lambda: self._create_strategy(method)
        )
        features = self.problem.feature_vector(self.theta)
        count = self.settings.neighbours or default_count
        return tuple(strategy.candidates(features, count))

    def _create_strategy(self, method: Method) -> Strategy:
        """Create the strategy of a method."""
        library = self.settings.library
        if self.settings.strategy is not None:
            return self.settings.strategy
        if self.settings.model is not None and method != "mpcc":
            return self._check_model(self.settings.model, method).create_strategy()
        if library is None:
            raise UsageError(
                f"method {method!r} needs solved problems: give a library (a plan file of "
                f"`climbplan solve` over `sample`)"
            )
        library.require(self.problem.program, len(self.problem.feature_vector(self.theta)))
        products = method != "mpcc" and self.instance.products.count > 0
        return NearestProblems.of(library, "mixed" if products else "strategies")

    def _check_model(self, model: StrategyModel, method: Method) -> StrategyModel:
        """Return the model if it fits the method and the problem."""
        if method not in ("pinned", "branch-and-bound", model.kind):
            raise UsageError(f"method {method!r} was given a model of kind {model.kind!r}")
        count = len(self.problem.feature_vector(self.theta))
        model.library.require(self.problem.program, count)
        return model

    def read_clusters(self) -> ClusterRanking:
        """Return the clusters of the model of `reduce`."""
        if self.settings.model is None:
            raise UsageError("method 'reduce' needs a trained model")
        return self._check_model(self.settings.model, "reduce").create_cluster_ranking()


@dataclass(frozen=True)
class Outcome:
    """A method's result, and the candidate, start or variant from which it came."""

    result: SolverResult
    winner: str
    tried: int
    fates: tuple[CandidateResult, ...] = ()  # results of candidates whose integers were fixed
    checked: bool = False  # whether the problem's own checker has been applied
    certificate: Certificate | None = None  # where the settings ask for one


def solve_candidates(
    task: Task,
    candidates: Iterable[Candidate],
    origin: Callable[[int, Candidate], str],
    check: Check | None = None,
    time_limit: float | None = None,
) -> Outcome:
    """Solve the programs at the candidates' integers, and return the best.

    Args:
        task: The task.
        candidates: Candidates in order.
        origin: Returns the name of the candidate at an index, for reports.
        check: Check of points, by default that of the task.
        time_limit: Time limit [s], by default that of the task.

    Raises:
        UsageError: The solver is unknown.
    """
    settings, solver = task.settings, task.settings.solver
    chosen = next((name for name in FIXED_INTEGER_SOLVERS if name == solver), None)
    if solver is not None and chosen is None:
        names = ", ".join(FIXED_INTEGER_SOLVERS)
        raise UsageError(f"pinned integers: no solver {solver!r}, expected one of {names}")
    options = replace(
        settings.pinned,
        local=chosen or settings.pinned.local,
        time_limit=task.time_left if time_limit is None else time_limit,
        tolerance=settings.tolerance,
        gap=settings.gap,
    )
    pipeline_result = run_pipeline(task.instance, candidates, options, check or task.check_point)
    if not pipeline_result.tried:
        no_answer = Answer(None, -np.inf, False, 0, 0.0, "none", ("no integers to keep",))
        return Outcome(
            judge_answer(task.instance, no_answer, settings.gap, settings.tolerance), "", 0
        )
    last = pipeline_result.tried[pipeline_result.winner]  # without a winner the last one
    answer = Answer(
        x=pipeline_result.x,
        bound=-np.inf,  # what solvers prove is about programs with fixed integers
        infeasible=False,
        nodes=sum(tried.programs for tried in pipeline_result.tried),
        time=time.perf_counter() - task.begin,
        solver=last.solver,
        log=(f"{last.solver}: {last.word}",),
        assignment=last.candidate.alternatives,
    )
    result = judge_answer(task.instance, answer, settings.gap, settings.tolerance)
    winner = origin(pipeline_result.winner, last.candidate) if pipeline_result.solved else ""
    return Outcome(result, winner, len(pipeline_result.tried), pipeline_result.tried, checked=True)


def format_origin(place: int, candidate: Candidate) -> str:
    """Return the name of a neighbour for reports."""
    return f"neighbour {place + 1} (row {candidate.row})"


def select_best(tried: Sequence[tuple[str, SolverResult]]) -> Outcome:
    """Select the cheapest answer that `Task.apply_own_check` accepted, else the last failure."""
    answers = [(r.objective, k) for k, (_, r) in enumerate(tried) if r.objective is not None]
    if not answers:
        return Outcome(tried[-1][1], "", len(tried))
    origin, result = tried[min(answers)[1]]
    return Outcome(result, origin, len(tried), checked=True)
