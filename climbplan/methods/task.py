"""One instance on its way through a method: settings, what may be tried, and the best of it."""

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
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.pinning import PINNED_SOLVERS
from climbplan.methods.pipeline import Check, Checked, PipelineOptions, Tried, run_pipeline
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.reformulations.complementarity import Complementarity
from climbplan.schema.program.model import ProgramMethod, ProgramStart
from climbplan.solvers.admm import AdmmOptions
from climbplan.solvers.ipopt.instances import middle
from climbplan.solvers.ipopt.mpcc import HOMOTOPY
from climbplan.solvers.result import Answer, SolverResult, judged

Method = ProgramMethod
Start = ProgramStart

_NEIGHBOURS = {"mpcc": 3}
_LEAST_SHARE = 0.1  # [s] that a follow-up gets when the time is over
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class MpccOptions:
    """Which complementarity is tried, one after the other, and eps from step to step."""

    forms: tuple[Complementarity, ...] = (
        Complementarity("product"),
        Complementarity("fischer-burmeister"),
    )
    homotopy: tuple[float, ...] = HOMOTOPY


@dataclass(frozen=True)
class MethodSettings:
    """How a method goes about it; what a method does not use it ignores.

    candidates: of `pinned`, before those of the library. library: of `knn`, of `mpcc` with start
    `knn`, and of `pinned`. pinned: what candidates go through; times, gaps and tolerances are those
    of the settings.
    """

    solver: str | None = None  # micp, admm: highs, scip, gurobi; pinned, knn: ipopt, sqp, ...
    gap: float = 1e-4  # relative
    time_limit: float = 60.0  # [s] of one instance
    tolerance: float = 1e-6  # largest violation of any row, in its own unit
    own_tolerance: float | None = None  # of the problem's own check, the same if left out
    start: Start | None = None  # of mpcc: manual if the problem states a guess, else zero
    work: int | None = None  # of a sequence: dual steps of one tree, which count the same each time
    certificate: bool = False  # branch-and-bound: a proof of the bound comes with the answer
    neighbours: int | None = None  # sets of integers to try: 10, 3 for mpcc
    fallback: Method | None = "minlp-scip"  # of learned methods, where no candidate holds
    library: Library | None = None
    model: StrategyModel | None = None  # of learned methods; knn may have a library instead
    strategy: Strategy | None = None  # one's own, in place of library and model
    candidates: Sequence[Candidate] = ()
    pinned: PipelineOptions = field(default_factory=PipelineOptions)
    envelopes: EnvelopeOptions = field(default_factory=EnvelopeOptions)
    mpcc: MpccOptions = field(default_factory=MpccOptions)
    admm: AdmmOptions = field(default_factory=lambda: AdmmOptions(freeze_after=2))


class Kept:
    """What the instances of one problem share by one method: made for the first, used by all."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def once(self, name: str, make: Callable[[], _Made]) -> _Made:
        """What was made under that name, made now if nothing was."""
        if name not in self._made:
            self._made[name] = make()
        return cast("_Made", self._made[name])


@dataclass(frozen=True)
class Task:
    """One instance of a problem on its way through a method."""

    problem: Problem
    theta: Theta
    instance: Instance
    settings: MethodSettings
    begin: float
    kept: Kept = field(default_factory=Kept)

    @property
    def left(self) -> float:
        """Time that is left [s], a little of it always."""
        return max(self.settings.time_limit - (time.perf_counter() - self.begin), _LEAST_SHARE)

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() - self.begin > self.settings.time_limit

    def guess(self) -> Array | None:
        """The problem's own start (n,)."""
        return self.problem.start_point(self.theta, middle(self.instance))

    def refusal(self, x: Array) -> str:
        """What the problem's own checker has against a point (n,); nothing: it passes."""
        own = self.settings.own_tolerance
        limit = self.settings.tolerance if own is None else own
        off = [
            f"{block.name.removeprefix('own.')} by {block.residual:.3g}"
            for block in self.problem.own_residuals(self.theta, x)
            if block.residual > limit
        ]
        return f"answer refused by the problem's own check: {', '.join(off)}" if off else ""

    def passing(self, result: SolverResult) -> SolverResult:
        """The result, its answer taken away if the problem's own checker refuses it."""
        refused = "" if result.x is None else self.refusal(result.x)
        if not refused:
            return result
        log = (*result.log, refused)
        return replace(
            result, status="limit", x=None, assignment=None, objective=None, gap=None, log=log
        )

    def checked(self, instance: Instance, x: Array) -> Checked:
        """Whether a point holds in the statement and for the problem's own checker."""
        cost = instance.objective(x)
        if np.isfinite(self.settings.tolerance):
            violation = instance.violation(x)
            if violation > self.settings.tolerance:
                return Checked(False, cost, x, f"violated by {violation:.2g}")
        refused = self.refusal(x)
        return Checked(not refused, cost, x, refused)

    def neighbours(self, method: Method) -> tuple[Candidate, ...]:
        """The nearest sets of integers in the library, each once; with products further starts."""
        strategy = self.kept.once(f"strategy of {method}", lambda: self._strategy(method))
        features = self.problem.feature_vector(self.theta)
        count = self.settings.neighbours or _NEIGHBOURS.get(method, 10)
        return tuple(strategy.candidates(features, count))

    def _strategy(self, method: Method) -> Strategy:
        library = self.settings.library
        if self.settings.strategy is not None:
            return self.settings.strategy
        if self.settings.model is not None and method != "mpcc":
            return self._trained(self.settings.model, method).strategy()
        if library is None:
            raise UsageError(
                f"method {method!r} needs solved problems: give a library (a plan file of "
                f"`climbplan solve` over `sample`)"
            )
        library.require(self.problem.program, len(self.problem.feature_vector(self.theta)))
        products = method != "mpcc" and self.instance.products.count > 0
        return NearestProblems.of(library, "mixed" if products else "strategies")

    def _trained(self, model: StrategyModel, method: Method) -> StrategyModel:
        """The model, if it is one of this method and problem."""
        if method not in ("pinned", "branch-and-bound", model.kind):
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
    """What a method found, and of which candidate, start or variant."""

    result: SolverResult
    winner: str
    tried: int
    fates: tuple[Tried, ...] = ()  # of candidates whose integers were kept
    checked: bool = False  # the problem's own checker has had its say
    certificate: Certificate | None = None  # where the settings ask for one


def all_pinned(
    task: Task,
    candidates: Iterable[Candidate],
    origin: Callable[[int, Candidate], str],
    check: Check | None = None,
    time_limit: float | None = None,
) -> Outcome:
    """The best of what is left when each candidate's integers are kept.

    origin: what reports call the candidate at a place. check: `task.checked` if left out.
    time_limit: [s] the task's if left out. Raises UsageError for an unknown solver.
    """
    settings, solver = task.settings, task.settings.solver
    chosen = next((name for name in PINNED_SOLVERS if name == solver), None)
    if solver is not None and chosen is None:
        known = ", ".join(PINNED_SOLVERS)
        raise UsageError(f"pinned integers: no solver {solver!r}, expected one of {known}")
    options = replace(
        settings.pinned,
        local=chosen or settings.pinned.local,
        time_limit=task.left if time_limit is None else time_limit,
        tolerance=settings.tolerance,
        gap=settings.gap,
    )
    found = run_pipeline(task.instance, candidates, options, check or task.checked)
    if not found.tried:
        nothing = Answer(None, -np.inf, False, 0, 0.0, "none", ("no integers to keep",))
        return Outcome(judged(task.instance, nothing, settings.gap, settings.tolerance), "", 0)
    last = found.tried[found.winner]  # without a winner the last one
    answer = Answer(
        x=found.x,
        bound=-np.inf,  # what solvers prove is about the pinned programs only
        infeasible=False,
        nodes=sum(tried.programs for tried in found.tried),
        time=time.perf_counter() - task.begin,
        solver=last.solver,
        log=(f"{last.solver}: {last.word}",),
        assignment=last.candidate.alternatives,
    )
    result = judged(task.instance, answer, settings.gap, settings.tolerance)
    winner = origin(found.winner, last.candidate) if found.solved else ""
    return Outcome(result, winner, len(found.tried), found.tried, checked=True)


def origin_of(place: int, candidate: Candidate) -> str:
    """What reports call a neighbour."""
    return f"neighbour {place + 1} (row {candidate.row})"


def best(tried: Sequence[tuple[str, SolverResult]]) -> Outcome:
    """The cheapest of answers that `Task.passing` let through, the last failure without one."""
    answers = [(r.objective, k) for k, (_, r) in enumerate(tried) if r.objective is not None]
    if not answers:
        return Outcome(tried[-1][1], "", len(tried))
    origin, result = tried[min(answers)[1]]
    return Outcome(result, origin, len(tried), checked=True)
