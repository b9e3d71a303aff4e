"""Every method for any stated problem, by name.

`solve_instance` is the one way in: a problem, its parameters and a method's name go in, a result
comes out that the exact statement has judged, with the candidate or variant that won.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from climbplan.errors import UsageError
from climbplan.learning.envelope_rounds import (
    MICP_SOLVERS,
    EnvelopeOptions,
    default_partitions,
    solve_micp,
)
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.learning.neighbours import NearestProblems
from climbplan.learning.pinning import PINNED_SOLVERS, at_point, distinct, solve_candidate
from climbplan.learning.reduce import ClusterRanking, ReducedPrograms
from climbplan.learning.strategy import Candidate
from climbplan.program.box import Box, product_range, propagated_box
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.program.problem import Problem, Theta
from climbplan.reformulations.base import Reformulated
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.grids import Partition
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.admm import AdmmOptions, solve_admm
from climbplan.solvers.ipopt import middle
from climbplan.solvers.mpcc import HOMOTOPY, STRAIGHT, solve_mpcc
from climbplan.solvers.registry import require
from climbplan.solvers.result import Answer, SolverResult, judged

Method = Literal[
    "minlp-scip",
    "minlp-bonmin",
    "micp",
    "mpcc",
    "admm",
    "pinned",
    "knn",
    "forest",
    "boosting",
    "network",
    "reduce",
]
Start = Literal["zero", "manual", "knn"]
METHODS: tuple[Method, ...] = get_args(Method)
NEEDS_LIBRARY = ("knn",)
NEEDS_MODEL = ("forest", "boosting", "network", "reduce")
_NEIGHBOURS = {"mpcc": 3}
_MORE_CLUSTERS = 4  # of reduce, while none gave an answer
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
class MethodResult:
    """An answer that the statement itself has judged, and how it was found."""

    result: SolverResult
    method: Method
    winner: str  # the candidate, start or variant of which the answer came; "" without one
    tried: int  # candidates or starts
    time: float  # [s] all in all, without imports


@dataclass(frozen=True)
class _Task:
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
class _Outcome:
    result: SolverResult
    winner: str
    tried: int


def solve_instance(
    problem: Problem,
    theta: Theta,
    method: Method = "micp",
    settings: MethodSettings | None = None,
) -> MethodResult:
    """Solve a problem at one theta by a method's name.

    No answer is returned that violates a row of the statement by more than the tolerance. Raises
    UsageError for parameters that do not fit, an unknown method or solver, a missing library, and
    missing bounds that the method needs; StatementError for what the statement itself does wrong;
    MissingSolver for a solver that is not installed.
    """
    if method not in _METHODS:
        raise UsageError(f"unknown method {method!r}: expected one of {', '.join(METHODS)}")
    settings = settings or MethodSettings()
    instance = problem.instance(theta)
    begin = time.perf_counter()
    outcome = _METHODS[method](_Task(problem, theta, instance, settings, begin))
    spent = time.perf_counter() - begin
    return MethodResult(
        replace(outcome.result, time=spent), method, outcome.winner, outcome.tried, spent
    )


def _minlp_scip(task: _Task) -> _Outcome:
    """SCIP on the whole statement; its point, good to SCIP's tolerance, is solved again exactly."""
    settings = task.settings
    found = require("minlp-scip").load()(task.instance, settings.gap, task.left)
    return _Outcome(_polished(task, found), "SCIP", 1)


def _minlp_bonmin(task: _Task) -> _Outcome:
    from climbplan.solvers.bonmin import solve_bonmin

    settings = task.settings
    guess = task.guess()
    found = solve_bonmin(task.instance, settings.gap, task.left, settings.tolerance, guess)
    return _Outcome(found, "Bonmin", 1)


def _micp(task: _Task) -> _Outcome:
    settings = task.settings
    options = settings.envelopes
    if settings.solver is not None:
        options = replace(options, solver=settings.solver)
    found = solve_micp(
        task.problem, task.instance, options, settings.gap, task.left, settings.tolerance
    )
    return _Outcome(found, f"envelopes ({options.solver})", 1)


def _mpcc(task: _Task) -> _Outcome:
    """Complementarity from the start asked for; neighbours need no wide homotopy."""
    settings = task.settings
    guess = task.guess()
    start = settings.start or ("zero" if guess is None else "manual")
    if start == "knn":
        near = task.neighbours("mpcc")
        plain = Complementarity()
        tried = [
            (_origin(k, c), _smoothed(task, c.start, c.alternatives, STRAIGHT, plain))
            for k, c in enumerate(near, 1)
        ]
        if all(result.x is None for _, result in tried):
            first = near[0]
            wide = _smoothed(task, first.start, first.alternatives, HOMOTOPY, plain)
            tried.append((f"{_origin(1, first)}, wide homotopy", wide))
        return _best(task, tried)
    if start == "manual" and guess is None:
        raise UsageError(
            f"problem {task.problem.name!r} states no `start`, which `start: manual` needs"
        )
    begin = None if start == "zero" else guess
    tried = []
    for kind in ("product", "fischer-burmeister"):
        method = Complementarity("product" if kind == "product" else "fischer-burmeister")
        result = _smoothed(task, begin, None, HOMOTOPY, method)
        tried.append((f"start {start}, {kind}", result))
        if result.x is not None:
            break
    return _best(task, tried)


def _smoothed(
    task: _Task,
    x: Array | None,
    assignment: Index | None,
    homotopy: tuple[float, ...],
    method: Complementarity,
) -> SolverResult:
    return solve_mpcc(
        task.instance,
        task.settings.gap,
        task.left,
        task.settings.tolerance,
        start=x,
        assignment=assignment,
        method=method,
        homotopy=homotopy,
    )


def _admm(task: _Task) -> _Outcome:
    """Envelopes and disjunctive rows on one side, the exact products on the other."""
    settings = task.settings
    solver = settings.solver or "highs"
    if solver not in MICP_SOLVERS:
        known = ", ".join(MICP_SOLVERS)
        raise UsageError(f"method 'admm': no solver {solver!r}, expected one of {known}")
    solve = require(MICP_SOLVERS[solver]).load()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        found = solve(disjoined.instance, gap=1e-3, time_limit=task.left)
        return None if found.x is None else disjoined.invert(found.x)

    def relax(instance: Instance) -> Reformulated:
        box = propagated_box(instance)
        pieces = settings.envelopes.pieces
        return McCormick(default_partitions(task.problem, instance, box, pieces)).apply(instance)

    answer = solve_admm(
        task.instance,
        mixed_integer,
        task.guess(),
        relax,
        settings.admm,
        settings.gap,
        task.left,
        settings.tolerance,
    )
    best = "" if answer.best is None else f"iteration {answer.best + 1}"
    return _Outcome(answer.result, best, len(answer.steps))


def _pinned(task: _Task) -> _Outcome:
    """The integers of given candidates, of the problem's guess and of neighbours; the best."""
    candidates = list(task.settings.candidates)
    origins = {id(c): f"candidate {k}" for k, c in enumerate(candidates, 1)}
    guess = task.guess()
    if guess is not None:
        candidates.append(at_point(guess, task.instance.assignment(guess)))
        origins[id(candidates[-1])] = "start manual"
    if task.settings.library is not None:
        candidates += task.neighbours("pinned")
    if not candidates:
        if task.instance.features & {"integers", "choices"}:
            raise UsageError(
                "method 'pinned' needs integers to keep: give a library, candidates, or a "
                f"`start` of problem {task.problem.name!r}"
            )
        candidates = [at_point(middle(task.instance), np.zeros(0, np.int64))]
        origins[id(candidates[0])] = "no integers"
    return _all_pinned(task, distinct(candidates, task.instance), origins)


def _learned(method: Method) -> Callable[[_Task], _Outcome]:
    """The best of the integers that a strategy names; another method where none of them holds."""

    def solve(task: _Task) -> _Outcome:
        if method in NEEDS_MODEL and task.settings.model is None:
            raise UsageError(
                f"method {method!r} needs a trained model: a model file of `climbplan fit-strategy`"
            )
        candidates = task.neighbours(method)
        origins = {}
        if task.settings.model is not None:
            origins = {id(c): f"candidate {k} ({method})" for k, c in enumerate(candidates, 1)}
        return _or_fallback(task, method, _all_pinned(task, candidates, origins))

    return solve


def _reduce(task: _Task) -> _Outcome:
    """The reduced mixed-integer programs of the likeliest clusters, made exact."""
    settings, ranking = task.settings, task.clusters()
    programs = ReducedPrograms(
        ranking,
        cluster_partitions(task.problem, task.instance, ranking.library, settings.envelopes.pieces),
        solver=settings.solver or "highs",
        seconds=task.left,
    )
    features = task.problem.feature_vector(task.theta)
    tried: list[tuple[str, SolverResult]] = []
    candidates = programs.candidates(
        task.instance,
        features,
        settings.neighbours or 1,
        task.left,
        _MORE_CLUSTERS,
        lambda: any(result.x is not None for _, result in tried),
    )
    for k, candidate in enumerate(candidates, 1):
        result = solve_candidate(
            task.instance, candidate, None, settings.gap, task.left, settings.tolerance
        )
        tried.append((f"candidate {k} (reduce)", result))
    if not tried:
        word = "no reduced program has a point"
        nothing = Answer(None, -np.inf, False, 0, 0.0, "reduce", (word,))
        tried.append(("", judged(task.instance, nothing, settings.gap, settings.tolerance)))
    return _or_fallback(task, "reduce", _best(task, tried))


def cluster_partitions(
    problem: Problem, instance: Instance, library: Library, count: int
) -> tuple[Partition, ...]:
    """Grids for reduced programs, the same for all parameters: over the stated bounds, and over
    what solutions range where there are none."""
    low, high = library.points.min(axis=0), library.points.max(axis=0)
    room = 0.1 * np.maximum(high - low, 1e-3)
    lower = np.where(np.isfinite(instance.lower), instance.lower, low - room)
    upper = np.where(np.isfinite(instance.upper), instance.upper, high + room)
    products = instance.products
    box = Box(lower, upper, product_range(lower, upper, products.first, products.second))
    return default_partitions(problem, instance, box, count)


def _or_fallback(task: _Task, method: Method, outcome: _Outcome) -> _Outcome:
    fallback = task.settings.fallback
    if outcome.result.x is not None or fallback is None:
        return outcome
    if fallback == method:
        raise UsageError(f"method {method!r} cannot be its own fallback")
    settings = replace(task.settings, solver=None)
    after = _METHODS[fallback](replace(task, settings=settings))
    return _Outcome(after.result, f"fallback {fallback}", outcome.tried + after.tried)


def _all_pinned(
    task: _Task, candidates: Sequence[Candidate], origins: Mapping[int, str] | None = None
) -> _Outcome:
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
        tried.append(((origins or {}).get(id(candidate), _origin(k, candidate)), result))
    return _best(task, tried)


def _origin(rank: int, candidate: Candidate) -> str:
    return f"neighbour {rank} (row {candidate.row})"


def _best(task: _Task, tried: Sequence[tuple[str, SolverResult]]) -> _Outcome:
    """The cheapest answer, the last failure if there is none."""
    answers = [(r.objective, k) for k, (_, r) in enumerate(tried) if r.objective is not None]
    if not answers:
        last = tried[-1][1]
        return _Outcome(last, "", len(tried))
    origin, result = tried[min(answers)[1]]
    return _Outcome(result, origin, len(tried))


def _polished(task: _Task, found: SolverResult) -> SolverResult:
    """The answer with its integers kept, solved to full accuracy; the bound stays."""
    if found.x is None or found.assignment is None:
        return found
    candidate = at_point(found.x, found.assignment)
    settings = task.settings
    again = solve_candidate(
        task.instance, candidate, None, settings.gap, task.left, settings.tolerance
    )
    if again.objective is None or (
        found.objective is not None and again.objective > found.objective
    ):
        again = found
    answer = Answer(
        x=again.x,
        bound=found.bound,
        infeasible=False,
        nodes=found.nodes,
        time=found.time,
        solver=found.solver,
        log=(*found.log, *again.log),
        assignment=found.assignment,
    )
    return judged(task.instance, answer, settings.gap, settings.tolerance)


_METHODS: dict[str, Callable[[_Task], _Outcome]] = {
    "minlp-scip": _minlp_scip,
    "minlp-bonmin": _minlp_bonmin,
    "micp": _micp,
    "mpcc": _mpcc,
    "admm": _admm,
    "pinned": _pinned,
    "knn": _learned("knn"),
    "forest": _learned("forest"),
    "boosting": _learned("boosting"),
    "network": _learned("network"),
    "reduce": _reduce,
}
