"""Methods on the whole statement: trees, SCIP, Bonmin, envelopes, complementarity, ADMM."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import LimitReached, UsageError
from climbplan.learning.strategy import Candidate
from climbplan.methods.candidate_solving import candidate_at, solve_candidate
from climbplan.methods.envelope_rounds import (
    MICP_SOLVERS,
    build_default_partitions,
    solve_micp,
)
from climbplan.methods.task import (
    MAX_ROOT_CANDIDATES,
    Method,
    Outcome,
    Task,
    format_origin,
    select_best,
)
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance
from climbplan.reformulations.base import Reformulated
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.admm import solve_admm
from climbplan.solvers.benders.method import solve_benders
from climbplan.solvers.ipopt.instances import solve_ipopt
from climbplan.solvers.ipopt.mpcc import STRAIGHT, solve_mpcc
from climbplan.solvers.mixed_integer.cone_rows import state_cones
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.outer_approximation import ConicSearch
from climbplan.solvers.mixed_integer.spatial_method import WarmStartedSpatialTree
from climbplan.solvers.registry import require
from climbplan.solvers.result import Answer, SolverResult, judge_answer
from climbplan.solvers.tree.branch_and_bound import is_conic, solve_branch_and_bound

_TREE: Method = "branch-and-bound"
_MAX_STARTS = 3  # neighbours from which complementarity starts


def solve_by_tree(task: Task) -> Outcome:
    """Solve by the built-in tree; products are branched on in space, unless rows are cones.

    Integers of a library, model or strategy are proposed to it first.
    """
    settings, name = task.settings, _TREE
    unsupported = task.instance.features - require(name).accepts
    if unsupported:
        raise UsageError(
            f"method {name!r} holds no {' and no '.join(sorted(unsupported))}: use mccormick, "
            "mpcc or pinned"
        )
    if settings.certificate:
        tree = _create_proving_tree(task)
        result = tree.solve(task.instance, task.time_left)
        return Outcome(result, "own tree", 1, certificate=tree.certificate)
    sources = settings.library, settings.model, settings.strategy
    proposals: tuple[Candidate, ...] = ()
    if any(source is not None for source in sources):
        proposals = task.find_neighbours(name, MAX_ROOT_CANDIDATES)
    stated = state_cones(task.instance)
    result = solve_branch_and_bound(
        stated, settings.gap, task.time_left, settings.tolerance, proposals=proposals
    )
    if stated is not task.instance and result.x is not None:
        result = _judge_as_stated(task, result)
    origin = "own tree, learned integers first" if proposals else "own tree"
    return Outcome(result, origin, 1 + len(proposals))


def _create_proving_tree(task: Task) -> WarmStartedTree | WarmStartedSpatialTree | ConicSearch:
    """Create the tree whose leaves' multipliers map to the statement's rows."""
    gap, tolerance = task.settings.gap, task.settings.tolerance
    if is_conic(task.instance):
        return ConicSearch(gap, tolerance, proves=True)
    solver_type = WarmStartedSpatialTree if task.instance.products.count else WarmStartedTree
    return solver_type(gap, tolerance, proves=True)


def solve_by_benders(task: Task) -> Outcome:
    """Solve by generalised Benders decomposition."""
    settings = task.settings
    result = solve_benders(task.instance, settings.gap, task.time_left, settings.tolerance)
    return Outcome(result, "Benders cuts", 1)


def solve_by_scip(task: Task) -> Outcome:
    """Solve by SCIP; the program at its integers is solved again to full accuracy."""
    settings = task.settings
    if task.instance.smooth is not None:
        raise UsageError(
            "method 'minlp-scip' cannot hold smooth rows: use minlp-bonmin, mpcc, pinned, "
            "mccormick or admm, without integers nlp"
        )
    result = require("minlp-scip").load()(task.instance, settings.gap, task.time_left)
    return Outcome(_polish(task, result), "SCIP", 1)


def solve_by_bonmin(task: Task) -> Outcome:
    """Solve by Bonmin."""
    from climbplan.solvers.bonmin import solve_bonmin

    settings = task.settings
    guess = task.compute_guess()
    result = solve_bonmin(task.instance, settings.gap, task.time_left, settings.tolerance, guess)
    return Outcome(result, "Bonmin", 1)


def solve_by_envelopes(task: Task) -> Outcome:
    """Solve by rounds of envelopes."""
    settings = task.settings
    options = settings.envelopes
    if settings.solver is not None:
        options = replace(options, solver=settings.solver)
    grid, form, without_smooth = options.grid, None, replace(task.instance, smooth=None)
    if grid is not None:
        try:
            form = task.kept.compute_once(
                "envelopes on the grid", lambda: grid.form(without_smooth, lambda: task.is_late)
            )
        except LimitReached as late:
            answer = Answer(None, -np.inf, False, 0, settings.time_limit, "mccormick", (str(late),))
            return Outcome(
                judge_answer(task.instance, answer, settings.gap, settings.tolerance), "", 0
            )
    result = solve_micp(
        task.problem,
        task.instance,
        options,
        settings.gap,
        task.time_left,
        settings.tolerance,
        form=form,
    )
    return Outcome(result, f"envelopes ({options.solver})", 1)


def solve_by_ipopt(task: Task) -> Outcome:
    """Solve a program without integers by IPOPT, from the problem's guess or the box center."""
    settings, guess = task.settings, task.compute_guess()
    if unsupported := task.instance.features & {"integers", "choices"}:
        raise UsageError(
            f"method 'nlp' holds no {' or '.join(sorted(unsupported))}: "
            "use mpcc, mccormick or pinned"
        )
    result = solve_ipopt(task.instance, settings.gap, task.time_left, settings.tolerance, guess)
    return Outcome(result, "start zero" if guess is None else "start manual", 1)


def solve_by_complementarity(task: Task) -> Outcome:
    """Solve by complementarity from the chosen start; neighbours need no wide homotopy."""
    settings = task.settings
    guess, how = task.compute_guess(), settings.mpcc
    start = settings.start or ("zero" if guess is None else "manual")
    tried: list[tuple[str, SolverResult]] = []
    if start == "knn":
        neighbours = task.find_neighbours("mpcc", _MAX_STARTS)
        for k, c in enumerate(neighbours):
            answer = _solve_homotopy(task, c.start, c.alternatives, STRAIGHT, how.forms[0])
            tried.append((format_origin(k, c), answer))
            if settings.pinned.stop == "first" and answer.x is not None:
                break
        if all(result.x is None for _, result in tried) and how.homotopy != STRAIGHT:
            first = neighbours[0]
            wide = _solve_homotopy(
                task, first.start, first.alternatives, how.homotopy, how.forms[0]
            )
            tried.append((f"{format_origin(0, first)}, wide homotopy", wide))
        return select_best(tried)
    if start == "manual" and guess is None:
        raise UsageError(
            f"problem {task.problem.name!r} states no `start`, which `start: manual` needs"
        )
    begin = None if start == "zero" else guess
    for form in how.forms:
        result = _solve_homotopy(task, begin, None, how.homotopy, form)
        tried.append((f"start {start}, {form.kind}", result))
        if result.x is not None:
            break
    return select_best(tried)


def _solve_homotopy(
    task: Task,
    x: Array | None,
    assignment: IntArray | None,
    homotopy: tuple[float, ...],
    method: Complementarity,
) -> SolverResult:
    """Solve by one homotopy, and check the answer."""
    result = solve_mpcc(
        task.instance,
        task.settings.gap,
        task.time_left,
        task.settings.tolerance,
        start=x,
        assignment=assignment,
        method=method,
        homotopy=homotopy,
    )
    return task.apply_own_check(result)


def solve_by_admm(task: Task) -> Outcome:
    """Solve by ADMM between envelopes with disjunctive rows and the exact products."""
    settings = task.settings
    solver = settings.solver or "highs"
    if solver not in MICP_SOLVERS:
        names = ", ".join(MICP_SOLVERS)
        raise UsageError(f"method 'admm': no solver {solver!r}, expected one of {names}")
    solve = require(MICP_SOLVERS[solver]).load()

    def mixed_integer(block: Instance) -> Array | None:
        disjoined = BigM().apply(block)
        result = solve(
            disjoined.instance, gap=settings.admm.mixed_integer_gap, time_limit=task.time_left
        )
        return None if result.x is None else disjoined.invert(result.x)

    def relax(instance: Instance) -> Reformulated:
        grid, pieces = settings.envelopes.grid, settings.envelopes.pieces
        if grid is None:
            box = propagate_box(instance)
            grid = McCormick(build_default_partitions(task.problem, instance, box, pieces))
        return grid.apply(instance)

    answer = solve_admm(
        task.instance,
        mixed_integer,
        task.compute_guess(),
        relax,
        settings.admm,
        gap=settings.gap,
        time_limit=task.time_left,
        tolerance=settings.tolerance,
    )
    best = "" if answer.best is None else f"iteration {answer.best + 1}"
    return Outcome(answer.result, best, len(answer.steps))


def _judge_as_stated(task: Task, result: SolverResult) -> SolverResult:
    """Judge a result of the cones by the rows as stated, polished where these hold less well."""
    settings = task.settings
    assert result.x is not None
    if task.instance.violation(result.x, result.assignment) > settings.tolerance:
        return _polish(task, result)
    answer = Answer(
        x=result.x,
        bound=result.bound,
        infeasible=False,
        nodes=result.nodes,
        time=result.time,
        solver=result.solver,
        log=result.log,
        assignment=result.assignment,
    )
    return judge_answer(task.instance, answer, settings.gap, settings.tolerance)


def _polish(task: Task, result: SolverResult) -> SolverResult:
    """Solve the program at the answer's integers to full accuracy; the bound stays."""
    if result.x is None or result.assignment is None:
        return result
    candidate = candidate_at(result.x, result.assignment)
    settings = task.settings
    polished = solve_candidate(
        task.instance, candidate, None, settings.gap, task.time_left, settings.tolerance
    )
    if polished.objective is None or (
        result.objective is not None and polished.objective > result.objective
    ):
        polished = result
    answer = Answer(
        x=polished.x,
        bound=result.bound,
        infeasible=False,
        nodes=result.nodes,
        time=result.time,
        solver=result.solver,
        log=(*result.log, *polished.log),
        assignment=result.assignment,
    )
    return judge_answer(task.instance, answer, settings.gap, settings.tolerance)
