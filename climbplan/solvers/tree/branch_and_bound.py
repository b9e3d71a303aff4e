"""Branch and bound over the choices of an instance, with DAQP re-solves as nodes.

Instances with integers or products go to the compiled tree (`climbplan/solvers/mixed_integer/`);
what follows is about choices alone, whose alternatives may be thousands.

There are no binaries and no big-M: a node allows a set of alternatives for each choice, and only
the bounds of rows differ between nodes. Balls enter as tangent half-spaces at relaxation points,
valid for the whole tree. Each node's bound is the relaxation's dual value, raised by the exact
minima of parts that only priced rows couple (`block_minima`); their minimisers give incumbents.
Alternatives whose sure gain (`dual_gains`) lifts the bound over the incumbent are excluded.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    Known,
    Proposal,
    SolverResult,
    judged,
)
from climbplan.solvers.tree.normal_form import OutOfTime, normal_form
from climbplan.solvers.tree.search import TreeSearch

NAME = "branch-and-bound"


def solve_branch_and_bound(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
    known: Known | None = None,
    nodes: float = np.inf,
    proposals: Sequence[Proposal] = (),
) -> SolverResult:
    """Globally optimal x of an instance, or the best one found in the time or nodes given.

    gap: relative gap to prove. time_limit: [s]. tolerance: largest violation of any constraint.
    known: from a laxer instance, solved before. nodes: at most; where
    they end it, the answer is the same on every machine. proposals: to try first. Deterministic
    unless the time limit is hit.
    Directions without cost must be bounded, by bounds, rows, balls or choices; otherwise no finite
    bound can be given.
    """
    if instance.features & {"integers", "implications", "products"}:
        from climbplan.solvers.mixed_integer.method import solve_mixed_integer
        from climbplan.solvers.mixed_integer.nodes import MOST
        from climbplan.solvers.mixed_integer.spatial_method import solve_spatial

        compiled = solve_spatial if instance.products.count else solve_mixed_integer
        most = int(nodes) if np.isfinite(nodes) else MOST
        return compiled(instance, gap, time_limit, tolerance, known, most, proposals)
    begin = time.perf_counter()
    deadline = begin + time_limit
    try:
        form = normal_form(instance, late=lambda: time.perf_counter() >= deadline)
    except OutOfTime:
        answer = Answer(
            x=None,
            bound=-np.inf,
            infeasible=False,
            nodes=0,
            time=time.perf_counter() - begin,
            solver=NAME,
            log=("the time was over before the search began",),
        )
        return judged(instance, answer, gap, tolerance)
    if form.contradiction:
        answer = Answer(
            x=None,
            bound=np.inf,
            infeasible=True,
            nodes=0,
            time=time.perf_counter() - begin,
            solver=NAME,
            log=(f"infeasible: {form.contradiction}",),
        )
        return judged(instance, answer, gap, tolerance)
    if form.size == 0:
        return _only_point(instance, form.cost.center, gap, tolerance, begin)
    choices = [p.alternatives for p in proposals]
    search = TreeSearch(instance, form, gap, deadline, tolerance, known, nodes, choices)
    search.run()
    found = search.incumbents.best
    answer = Answer(
        x=None if found is None else found.x,
        assignment=None if found is None else found.assignment,
        bound=search.bound,
        infeasible=found is None and search.exhausted,
        nodes=search.nodes,
        time=time.perf_counter() - begin,
        solver=NAME,
        log=tuple(search.log),
    )
    return judged(instance, answer, gap, tolerance)


def _only_point(
    instance: Instance, x: Array, gap: float, tolerance: float, begin: float
) -> SolverResult:
    """The result if equations leave one point."""
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
    return judged(instance, answer, gap, tolerance)
