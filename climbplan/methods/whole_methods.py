"""Methods on the whole statement: SCIP, Bonmin, envelopes, complementarity, ADMM."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import LimitReached, UsageError
from climbplan.methods.envelope_rounds import (
    MICP_SOLVERS,
    default_partitions,
    solve_micp,
)
from climbplan.methods.pinning import at_point, solve_candidate
from climbplan.methods.task import Method, Outcome, Task, best, origin_of
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance
from climbplan.reformulations.base import Reformulated
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.admm import solve_admm
from climbplan.solvers.benders.method import solve_benders
from climbplan.solvers.ipopt.instances import solve_ipopt
from climbplan.solvers.ipopt.mpcc import STRAIGHT, solve_mpcc
from climbplan.solvers.mixed_integer.method import TreeMemory
from climbplan.solvers.mixed_integer.spatial_method import SpatialMemory
from climbplan.solvers.registry import require
from climbplan.solvers.result import Answer, SolverResult, judged
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound

_TREE: Method = "branch-and-bound"


def branch_and_bound(task: Task) -> Outcome:
    """The own tree on the whole statement; products of variables are branched on in space.

    Integers of a library, model or strategy are proposed to it first.
    """
    settings, name = task.settings, _TREE
    beyond = task.instance.features - require(name).accepts
    if beyond:
        raise UsageError(
            f"method {name!r} holds no {' and no '.join(sorted(beyond))}: use micp, mpcc or pinned"
        )
    if settings.certificate:
        # The tree over integers, or that over space, whose leaves are told in the statement's rows
        made = SpatialMemory if task.instance.products.count else TreeMemory
        tree = made(settings.gap, settings.tolerance, proves=True)
        found = tree.solve(task.instance, task.left)
        return Outcome(found, "own tree", 1, certificate=tree.certificate)
    learned = settings.library, settings.model, settings.strategy
    first = task.neighbours(name) if any(part is not None for part in learned) else ()
    found = solve_branch_and_bound(
        task.instance, settings.gap, task.left, settings.tolerance, proposals=first
    )
    return Outcome(found, "own tree", 1 + len(first))


def benders(task: Task) -> Outcome:
    """Integers by cuts, the convex program that is left by the solver of tree nodes."""
    settings = task.settings
    found = solve_benders(task.instance, settings.gap, task.left, settings.tolerance)
    return Outcome(found, "Benders cuts", 1)


def minlp_scip(task: Task) -> Outcome:
    """SCIP on the whole statement; its point, good to SCIP's tolerance, is solved again exactly."""
    settings = task.settings
    if task.instance.smooth is not None:
        raise UsageError(
            "method 'minlp-scip' cannot hold smooth rows: use minlp-bonmin, mpcc, pinned, micp or "
            "admm, without integers nlp"
        )
    found = require("minlp-scip").load()(task.instance, settings.gap, task.left)
    return Outcome(_polished(task, found), "SCIP", 1)


def minlp_bonmin(task: Task) -> Outcome:
    from climbplan.solvers.bonmin import solve_bonmin

    settings = task.settings
    guess = task.guess()
    found = solve_bonmin(task.instance, settings.gap, task.left, settings.tolerance, guess)
    return Outcome(found, "Bonmin", 1)


def micp(task: Task) -> Outcome:
    settings = task.settings
    options = settings.envelopes
    if settings.solver is not None:
        options = replace(options, solver=settings.solver)
    grid, form, plain = options.grid, None, replace(task.instance, smooth=None)
    if grid is not None:
        try:
            form = task.kept.once(
                "envelopes on the grid", lambda: grid.form(plain, lambda: task.is_late)
            )
        except LimitReached as late:
            answer = Answer(None, -np.inf, False, 0, settings.time_limit, "micp", (str(late),))
            return Outcome(judged(task.instance, answer, settings.gap, settings.tolerance), "", 0)
    found = solve_micp(
        task.problem, task.instance, options, settings.gap, task.left, settings.tolerance, form
    )
    return Outcome(found, f"envelopes ({options.solver})", 1)


def nlp(task: Task) -> Outcome:
    """IPOPT on a program without integers, from the problem's guess or the middle of its bounds."""
    settings, guess = task.settings, task.guess()
    if beyond := task.instance.features & {"integers", "choices"}:
        raise UsageError(
            f"method 'nlp' holds no {' or '.join(sorted(beyond))}: use mpcc, micp or pinned"
        )
    found = solve_ipopt(task.instance, settings.gap, task.left, settings.tolerance, guess)
    return Outcome(found, "start zero" if guess is None else "start manual", 1)


def mpcc(task: Task) -> Outcome:
    """Complementarity from the start asked for; neighbours need no wide homotopy."""
    settings = task.settings
    guess, how = task.guess(), settings.mpcc
    start = settings.start or ("zero" if guess is None else "manual")
    tried: list[tuple[str, SolverResult]] = []
    if start == "knn":
        near = task.neighbours("mpcc")
        for k, c in enumerate(near):
            found = _smoothed(task, c.start, c.alternatives, STRAIGHT, how.forms[0])
            tried.append((origin_of(k, c), found))
            if settings.pinned.stop == "first" and found.x is not None:
                break
        if all(result.x is None for _, result in tried) and how.homotopy != STRAIGHT:
            first = near[0]
            wide = _smoothed(task, first.start, first.alternatives, how.homotopy, how.forms[0])
            tried.append((f"{origin_of(0, first)}, wide homotopy", wide))
        return best(tried)
    if start == "manual" and guess is None:
        raise UsageError(
            f"problem {task.problem.name!r} states no `start`, which `start: manual` needs"
        )
    begin = None if start == "zero" else guess
    for form in how.forms:
        result = _smoothed(task, begin, None, how.homotopy, form)
        tried.append((f"start {start}, {form.kind}", result))
        if result.x is not None:
            break
    return best(tried)


def _smoothed(
    task: Task,
    x: Array | None,
    assignment: IntArray | None,
    homotopy: tuple[float, ...],
    method: Complementarity,
) -> SolverResult:
    found = solve_mpcc(
        task.instance,
        task.settings.gap,
        task.left,
        task.settings.tolerance,
        start=x,
        assignment=assignment,
        method=method,
        homotopy=homotopy,
    )
    return task.passing(found)


def admm(task: Task) -> Outcome:
    """Envelopes and disjunctive rows on one side, the exact products on the other."""
    settings = task.settings
    solver = settings.solver or "highs"
    if solver not in MICP_SOLVERS:
        known = ", ".join(MICP_SOLVERS)
        raise UsageError(f"method 'admm': no solver {solver!r}, expected one of {known}")
    solve = require(MICP_SOLVERS[solver]).load()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        found = solve(disjoined.instance, gap=settings.admm.mixed_integer_gap, time_limit=task.left)
        return None if found.x is None else disjoined.invert(found.x)

    def relax(instance: Instance) -> Reformulated:
        grid, pieces = settings.envelopes.grid, settings.envelopes.pieces
        if grid is None:
            box = propagated_box(instance)
            grid = McCormick(default_partitions(task.problem, instance, box, pieces))
        return grid.apply(instance)

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
    return Outcome(answer.result, best, len(answer.steps))


def _polished(task: Task, found: SolverResult) -> SolverResult:
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
