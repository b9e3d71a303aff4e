"""Every method for any stated problem, by name.

`solve_instance` is the one way in: a problem, its parameters and a method's name go in, a result
comes out that the exact statement has judged, with the candidate or variant that won.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from climbplan.certificates.certificate import Certificate
from climbplan.errors import UsageError
from climbplan.methods.pinned_methods import (
    NEEDS_MODEL,
    create_learned_method,
    solve_pinned_candidates,
    solve_reduced,
)
from climbplan.methods.pipeline import CandidateResult
from climbplan.methods.task import Method, MethodSettings, Outcome, SharedCache, Task
from climbplan.methods.whole_methods import (
    solve_by_admm,
    solve_by_benders,
    solve_by_bonmin,
    solve_by_complementarity,
    solve_by_envelopes,
    solve_by_ipopt,
    solve_by_scip,
    solve_by_tree,
)
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.mixed_integer.cost import Unbounded
from climbplan.solvers.registry import require
from climbplan.solvers.result import SolverResult

METHODS: tuple[Method, ...] = get_args(Method)
NEEDS_LIBRARY = ("knn",)
LEARNED = (*NEEDS_LIBRARY, *NEEDS_MODEL)
_MAX_PRODUCTS = 50  # largest number of products for which `auto` selects the built-in tree


@dataclass(frozen=True)
class MethodResult:
    """An answer that the statement itself has judged, and how it was found."""

    result: SolverResult
    method: Method
    winner: str  # candidate, start or variant from which the answer came; "" without one
    tried: int  # number of candidates or starts
    fates: tuple[CandidateResult, ...]  # results of candidates whose integers were fixed
    time: float  # total time without imports [s]
    certificate: Certificate | None = None  # of the bound, where the settings ask for one


def solve_instance(
    problem: Problem,
    theta: Theta,
    method: Method = "auto",
    settings: MethodSettings | None = None,
    kept: SharedCache | None = None,
) -> MethodResult:
    """Solve a problem at one theta by a method's name.

    kept: the same for all instances of one problem, method and settings, so that what they share
    is built once.

    No answer is returned that violates a row of the statement by more than the tolerance, or that
    the problem's own checker refuses. Raises
    UsageError for parameters that do not fit, an unknown method or solver, a missing library, and
    missing bounds that the method needs; StatementError for what the statement itself does wrong;
    MissingSolver for a solver that is not installed.
    """
    if method not in METHODS:
        raise UsageError(f"unknown method {method!r}: expected one of {', '.join(METHODS)}")
    settings = settings or MethodSettings()
    instance = problem.instance(theta)
    chosen = method == "auto"
    if method == "auto":
        method = _select_method(instance, settings)
    if settings.certificate and method != "branch-and-bound":
        raise UsageError(f"a certificate is made by method branch-and-bound, not by {method!r}")
    begin = time.perf_counter()
    task = Task(problem, theta, instance, settings, begin, kept or SharedCache())
    if chosen and method == "branch-and-bound":
        outcome, method = _solve_by_tree_or_micp(task)
    else:
        outcome = _METHODS[method](task)
    if method in LEARNED and outcome.result.x is None and settings.fallback is not None:
        outcome = _solve_by_fallback(task, method, settings.fallback, outcome)
    result = outcome.result if outcome.checked else task.apply_own_check(outcome.result)
    spent = time.perf_counter() - begin
    return MethodResult(
        replace(result, time=spent),
        method,
        outcome.winner,
        outcome.tried,
        outcome.fates,
        spent,
        outcome.certificate,
    )


def _select_method(instance: Instance, settings: MethodSettings) -> Method:
    """The own tree where it holds the statement and no other solver is asked for, else `micp`.

    `micp`, too, for more products than the tree, whose matrices are dense, is fast with.
    """
    own = instance.features <= require("branch-and-bound").accepts and settings.solver is None
    own = own and instance.products.count <= _MAX_PRODUCTS
    return "branch-and-bound" if own else "micp"


def _solve_by_tree_or_micp(task: Task) -> tuple[Outcome, Method]:
    """The own tree; `micp` where nothing bounds a direction that costs nothing, nor the answer."""
    own = None
    try:
        own = solve_by_tree(task)
    except Unbounded:
        if task.settings.certificate:
            raise
    if own is not None and (task.settings.certificate or not np.isneginf(own.result.bound)):
        return own, "branch-and-bound"
    other = solve_by_envelopes(task)
    if own is not None and other.result.x is None and own.result.x is not None:
        return own, "branch-and-bound"
    return other, "micp"


def _solve_by_fallback(task: Task, method: Method, fallback: Method, outcome: Outcome) -> Outcome:
    """Another method, where no candidate of a learned one holds."""
    if fallback == method:
        raise UsageError(f"method {method!r} cannot be its own fallback")
    after = _METHODS[fallback](replace(task, settings=replace(task.settings, solver=None)))
    fates = (*outcome.fates, *after.fates)
    tried = outcome.tried + after.tried
    return Outcome(after.result, f"fallback {fallback}", tried, fates, after.checked)


_METHODS: dict[str, Callable[[Task], Outcome]] = {
    "branch-and-bound": solve_by_tree,
    "benders": solve_by_benders,
    "minlp-scip": solve_by_scip,
    "minlp-bonmin": solve_by_bonmin,
    "micp": solve_by_envelopes,
    "nlp": solve_by_ipopt,
    "mpcc": solve_by_complementarity,
    "admm": solve_by_admm,
    "pinned": solve_pinned_candidates,
    "knn": create_learned_method("knn"),
    "forest": create_learned_method("forest"),
    "boosting": create_learned_method("boosting"),
    "network": create_learned_method("network"),
    "reduce": solve_reduced,
}
