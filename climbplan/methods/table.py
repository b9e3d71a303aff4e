"""Methods for stated problems, by name.

`solve_instance` takes a problem, its parameters and a method's name. It returns a result that the
exact statement has judged, with the candidate or variant from which it came.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from climbplan.certificates.certificate import Certificate
from climbplan.errors import UsageError
from climbplan.methods.fixed_integer_methods import (
    NEEDS_MODEL,
    create_learned_method,
    solve_fixed_integer_candidates,
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
from climbplan.solvers.mixed_integer.cone_rows import state_cones
from climbplan.solvers.mixed_integer.cost import Unbounded
from climbplan.solvers.mixed_integer.unbounded import examine_unbounded
from climbplan.solvers.registry import require
from climbplan.solvers.result import SolverResult
from climbplan.solvers.separable_cost import NotConvexCost, describe_nonconvexity, is_convex

METHODS: tuple[Method, ...] = get_args(Method)
NEEDS_LIBRARY = ("knn",)
LEARNED = (*NEEDS_LIBRARY, *NEEDS_MODEL)
_BEYOND_BINARIES = frozenset({"cones", "integers beyond 0 and 1"})
_LINEAR = frozenset({"integers", "integers beyond 0 and 1"})  # of programs that HiGHS takes whole
_CONIC_METHODS = ("branch-and-bound", "minlp-scip")  # hold these two features
_GENERAL_COSTS = ("minlp-scip", "minlp-bonmin", "nlp", "mpcc")  # hold costs that are not convex
_MAX_LINEAR_INTEGERS = 30  # from which on HiGHS, with its cuts, solves linear programs faster
_MAX_PRODUCTS = 50  # largest number of products for which `auto` selects the built-in tree


@dataclass(frozen=True)
class MethodResult:
    """An answer that the statement itself has judged, and its origin."""

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

    No answer is returned that violates a row of the statement by more than the tolerance, or that
    the problem's own checker rejects.

    Args:
        problem: The problem.
        theta: Its parameters by block.
        method: Name of the method.
        settings: Settings of the method.
        kept: Cache for all instances of one problem, method and settings.

    Raises:
        UsageError: Parameters do not fit, a method or solver is unknown, a library is missing,
            bounds are missing that the method needs, or the cost is not convex.
        StatementError: The statement itself is wrong.
        MissingSolver: A solver is not installed.
    """
    if method not in METHODS:
        raise UsageError(f"unknown method {method!r}: expected one of {', '.join(METHODS)}")
    settings = settings or MethodSettings()
    instance = problem.instance(theta)
    is_automatic = method == "auto"
    method = _select_method(instance, settings) if is_automatic else method
    if method not in _GENERAL_COSTS and not is_convex(instance.P):
        raise NotConvexCost(describe_nonconvexity(instance.name))
    if settings.certificate and method != "branch-and-bound":
        raise UsageError(f"a certificate is made by method branch-and-bound, not by {method!r}")
    _check_features(instance, method)
    begin = time.perf_counter()
    task = Task(problem, theta, instance, settings, begin, kept or SharedCache())
    if is_automatic and method == "branch-and-bound":
        outcome, method = _solve_by_tree_or_mccormick(task)
    else:
        outcome = _METHODS[method](task)
    if method in LEARNED and settings.fallback is not None and _is_open(outcome):
        outcome = _solve_by_fallback(task, method, settings.fallback, outcome)
    result = outcome.result if outcome.checked else task.apply_own_check(outcome.result)
    duration = time.perf_counter() - begin
    return MethodResult(
        replace(result, time=duration),
        method,
        outcome.winner,
        outcome.tried,
        outcome.fates,
        duration,
        outcome.certificate,
    )


def _check_features(instance: Instance, method: Method) -> None:
    """Raise UsageError for cones and integers that the method does not hold."""
    beyond = instance.features & _BEYOND_BINARIES
    if method == "mccormick" and instance.features <= _LINEAR:
        beyond = frozenset()
    if beyond and method not in _CONIC_METHODS:
        raise UsageError(
            f"method {method!r} holds no {' and no '.join(sorted(beyond))}: use "
            + " or ".join(_CONIC_METHODS)
        )


def _select_method(instance: Instance, settings: MethodSettings) -> Method:
    """Select the built-in tree where it supports the statement and no other solver is required.

    `mccormick` is selected for more products than the tree, whose matrices are dense, solves fast,
    and for mixed-integer linear programs, which HiGHS then solves. SCIP alone bounds costs that are
    not convex. With a model or a strategy it is the tree, which tries their integers first, or the
    model's own method where the tree does not support the statement.
    """
    is_convex_cost = is_convex(instance.P)
    is_for_tree = instance.features <= require("branch-and-bound").accepts and is_convex_cost
    if settings.model is not None or settings.strategy is not None:
        if is_for_tree:
            return "branch-and-bound"
        return "knn" if settings.model is None else settings.model.kind
    if not is_convex_cost:
        return "minlp-scip"
    uses_tree = is_for_tree and settings.solver is None
    if uses_tree and instance.products.count > _MAX_PRODUCTS:
        uses_tree = state_cones(instance).products.count <= _MAX_PRODUCTS
    is_linear = instance.features <= _LINEAR and not instance.P.count_nonzero()
    if is_linear and instance.binary_count > _MAX_LINEAR_INTEGERS and not settings.certificate:
        uses_tree = False
    return "branch-and-bound" if uses_tree else "mccormick"


def _solve_by_tree_or_mccormick(task: Task) -> tuple[Outcome, Method]:
    """Solve by the built-in tree, or by `mccormick` where a direction without cost is unbounded."""
    tree_outcome = None
    try:
        tree_outcome = solve_by_tree(task)
    except Unbounded:
        if task.settings.certificate:
            raise
    if tree_outcome is not None and (
        task.settings.certificate or not np.isneginf(tree_outcome.result.bound)
    ):
        return tree_outcome, "branch-and-bound"
    mccormick_outcome = solve_by_envelopes(task)
    if mccormick_outcome.result.x is None and tree_outcome is not None:
        falling = _find_falling_variables(task)
        if falling:
            message = f"unbounded: the cost falls without end along {falling}; give it bounds"
            empty = replace(mccormick_outcome.result, log=(*mccormick_outcome.result.log, message))
            return replace(mccormick_outcome, result=empty), "branch-and-bound"
        if tree_outcome.result.x is not None:
            return tree_outcome, "branch-and-bound"
    return mccormick_outcome, "mccormick"


def _find_falling_variables(task: Task) -> str:
    """Return the blocks of variables along which the cost is proved to be unbounded, or ""."""
    instance = task.instance
    if instance.features & {"choices", "implications", "products", "smooth"}:
        return ""
    proof = examine_unbounded(instance, task.time_left)
    if not proof.is_unbounded or proof.direction is None:
        return ""
    blocks = task.problem.values(proof.direction)
    return ", ".join(name for name, values in blocks.items() if np.abs(values).max(initial=0) > 0.1)


def _is_open(outcome: Outcome) -> bool:
    """Return whether an outcome is neither an answer nor a proof that there is none."""
    return outcome.result.x is None and outcome.result.status != "infeasible"


def _solve_by_fallback(task: Task, method: Method, fallback: Method, outcome: Outcome) -> Outcome:
    """Solve by another method, where no candidate of a learned one is feasible."""
    if fallback == method:
        raise UsageError(f"method {method!r} cannot be its own fallback")
    fallback_outcome = _METHODS[fallback](
        replace(task, settings=replace(task.settings, solver=None))
    )
    fates = (*outcome.fates, *fallback_outcome.fates)
    tried = outcome.tried + fallback_outcome.tried
    return Outcome(
        fallback_outcome.result, f"fallback {fallback}", tried, fates, fallback_outcome.checked
    )


_METHODS: dict[str, Callable[[Task], Outcome]] = {
    "branch-and-bound": solve_by_tree,
    "benders": solve_by_benders,
    "minlp-scip": solve_by_scip,
    "minlp-bonmin": solve_by_bonmin,
    "mccormick": solve_by_envelopes,
    "nlp": solve_by_ipopt,
    "mpcc": solve_by_complementarity,
    "admm": solve_by_admm,
    "pinned": solve_fixed_integer_candidates,
    "knn": create_learned_method("knn"),
    "forest": create_learned_method("forest"),
    "boosting": create_learned_method("boosting"),
    "network": create_learned_method("network"),
    "reduce": solve_reduced,
}
