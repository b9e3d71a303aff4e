"""Branch and bound over the choices of an instance, with DAQP re-solves as nodes.

Instances with integers or products go to the compiled tree (`climbplan/solvers/mixed_integer/`).
This file is about choices alone, whose alternatives may be thousands.

There are no binaries and no big-M: a node allows a set of alternatives for each choice, and only
the bounds of rows differ between nodes. Balls enter as tangent half-spaces at relaxation points,
valid for the whole tree. Each node's bound is the relaxation's dual value, raised by the exact
minima of components that only priced rows couple (`block_minima`); their minimisers give
incumbents. Alternatives whose guaranteed gain (`dual_gains`) lifts the bound over the incumbent are
excluded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.solvers.result import (
    FEASIBILITY,
    INFEASIBLE_MESSAGE,
    Answer,
    KnownResult,
    Proposal,
    SolverResult,
    judge_answer,
)
from climbplan.solvers.tree.normal_form import OutOfTime, build_normal_form
from climbplan.solvers.tree.search import TreeSearch

NAME = "branch-and-bound"


def solve_branch_and_bound(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    *,
    known_result: KnownResult | None = None,
    nodes: float = np.inf,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Find the global optimum of an instance, or the best point within the time or nodes given.

    The result is deterministic unless the time limit is hit.

    Args:
        instance: Instance whose directions without cost are bounded by bounds, rows, balls or
            choices.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.
        known_result: Bound and choices of a relaxed instance that was solved before.
        nodes: Largest number of nodes; where it ends the search, the answer is the same on every
            machine.
        proposals: Assignments to try first.
    """
    if instance.features & {"integers", "implications", "products", "cones"}:
        return _load_compiled_tree(instance, nodes)(
            instance, gap, time_limit, tolerance, known_result=known_result, proposals=proposals
        )
    begin = time.perf_counter()
    deadline = begin + time_limit
    try:
        form = build_normal_form(instance, late=lambda: time.perf_counter() >= deadline)
    except OutOfTime:
        message = "the time was over before the search began"
        answer = _build_empty_answer(message, begin, infeasible=False)
        return judge_answer(instance, answer, gap, tolerance)
    if form.contradiction:
        answer = _build_empty_answer(f"infeasible: {form.contradiction}", begin, infeasible=True)
        return judge_answer(instance, answer, gap, tolerance)
    if form.size == 0:
        return _answer_single_point(instance, form.cost.center, gap, tolerance, begin)
    choices = [p.alternatives for p in proposals]
    search = TreeSearch(
        instance, form, gap, deadline, tolerance, known_result, max_nodes=nodes, proposals=choices
    )
    search.run()
    incumbent = search.incumbents.best
    if incumbent is None and search.proves_infeasible:
        search.log.append(INFEASIBLE_MESSAGE)
    answer = Answer(
        x=None if incumbent is None else incumbent.x,
        assignment=None if incumbent is None else incumbent.assignment,
        bound=search.bound,
        infeasible=incumbent is None and search.proves_infeasible,
        nodes=search.num_nodes,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(search.log),
    )
    return judge_answer(instance, answer, gap, tolerance)


def is_conic(instance: Instance) -> bool:
    """Return whether only integers are beyond a convex program with second-order cones."""
    beyond = instance.features & {"choices", "implications", "products"}
    return "cones" in instance.features and not beyond


def _load_compiled_tree(instance: Instance, nodes: float) -> Callable[..., SolverResult]:
    """Load the compiled tree for an instance with integers or products, with a limit of nodes."""
    from climbplan.solvers.mixed_integer.method import solve_mixed_integer
    from climbplan.solvers.mixed_integer.nodes import UNLIMITED
    from climbplan.solvers.mixed_integer.outer_approximation import solve_conic
    from climbplan.solvers.mixed_integer.spatial_method import solve_spatial

    if is_conic(instance):  # which takes neither proposals nor known results
        return lambda instance, gap, time_limit, tolerance, **_: solve_conic(
            instance, gap, time_limit, tolerance
        )
    solve = solve_spatial if instance.products.count else solve_mixed_integer
    return partial(solve, nodes=int(nodes) if np.isfinite(nodes) else UNLIMITED)


def _build_empty_answer(message: str, begin: float, infeasible: bool) -> Answer:
    """Return the answer of an instance that was not searched."""
    return Answer(
        x=None,
        bound=np.inf if infeasible else -np.inf,
        infeasible=infeasible,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=(message,),
    )


def _answer_single_point(
    instance: Instance, x: Array, gap: float, tolerance: float, begin: float
) -> SolverResult:
    """Return the result if equations leave one point."""
    feasible = instance.violation(x) <= tolerance
    answer = Answer(
        x=x if feasible else None,
        bound=instance.objective(x) if feasible else np.inf,
        infeasible=not feasible,
        nodes=0,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=("equations leave one point",),
    )
    return judge_answer(instance, answer, gap, tolerance)
