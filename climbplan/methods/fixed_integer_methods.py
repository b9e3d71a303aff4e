"""Methods that keep integers: those given, those of neighbours, those that a model names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.strategy import Candidate
from climbplan.methods.candidate_solving import build_integer_key, candidate_at, drop_duplicates
from climbplan.methods.envelope_rounds import build_default_partitions
from climbplan.methods.pipeline import CheckedPoint
from climbplan.methods.reduced_programs import ReducedPrograms
from climbplan.methods.task import (
    MAX_ROOT_CANDIDATES,
    Method,
    Outcome,
    Task,
    format_origin,
    solve_candidates,
)
from climbplan.program.box import VariableBox, compute_product_range
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem
from climbplan.reformulations.grids import Partition
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.ipopt.instances import compute_box_center
from climbplan.solvers.registry import require
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound

NEEDS_MODEL = ("forest", "boosting", "network", "reduce")
REDUCED = "reduced programs"  # what `Kept` has them by
_MORE_CLUSTERS = 4  # of reduce, while none gave an answer


def solve_fixed_integer_candidates(task: Task) -> Outcome:
    """Fix the integers of candidates, of the problem's guess and of neighbours; keep the best."""
    candidates = list(task.settings.candidates)
    origins = {id(c): f"candidate {k}" for k, c in enumerate(candidates, 1)}
    guess = task.compute_guess()
    if guess is not None:
        candidates.append(candidate_at(guess, task.instance.assignment(guess)))
        origins[id(candidates[-1])] = "start manual"
    if task.settings.library is not None:
        candidates += task.find_neighbours("pinned")
    if not candidates:
        if task.instance.features & {"integers", "choices"}:
            raise UsageError(
                "method 'pinned' needs integers to keep: give a library, candidates, or a "
                f"`start` of problem {task.problem.name!r}"
            )
        candidates = [candidate_at(compute_box_center(task.instance), np.zeros(0, np.int64))]
        origins[id(candidates[0])] = "no integers"
    return solve_candidates(
        task,
        drop_duplicates(candidates, task.instance),
        lambda place, candidate: origins.get(id(candidate)) or format_origin(place, candidate),
    )


def create_learned_method(method: Method) -> Callable[[Task], Outcome]:
    """Create the method that tries the integers which a strategy names."""

    def solve(task: Task) -> Outcome:
        settings = task.settings
        if method in NEEDS_MODEL and settings.model is None and settings.strategy is None:
            raise UsageError(
                f"method {method!r} needs a trained model: a model file of `climbplan fit-strategy`"
            )
        has_model = settings.model is not None

        def format_candidate(place: int, candidate: Candidate) -> str:
            if has_model:
                return f"candidate {place + 1} ({method})"
            return format_origin(place, candidate)

        if _is_for_compiled_tree(task):
            candidates = task.find_neighbours(method, MAX_ROOT_CANDIDATES)
            return _try_at_root(task, candidates, format_candidate)
        return solve_candidates(task, task.find_neighbours(method), format_candidate)

    return solve


def _is_for_compiled_tree(task: Task) -> bool:
    """Return whether the compiled tree, one node of it, is the quickest way to try candidates."""
    features = task.instance.features
    return (
        task.settings.solver is None
        and task.problem.check is None  # candidates that it rejects must not win
        and bool(features & {"integers", "implications"})
        and not features & {"products", "cones"}
        and features <= require("branch-and-bound").accepts
    )


def _try_at_root(
    task: Task, candidates: tuple[Candidate, ...], origin: Callable[[int, Candidate], str]
) -> Outcome:
    """Try the integers of candidates at the root of the compiled tree, whose bound is valid."""
    settings, instance = task.settings, task.instance
    result = solve_branch_and_bound(
        instance, settings.gap, task.time_left, settings.tolerance, nodes=1, proposals=candidates
    )
    winner = ""
    if result.x is not None and result.assignment is not None:
        key = build_integer_key(instance, result.x, result.assignment)
        winners = (
            origin(k, candidate)
            for k, candidate in enumerate(candidates)
            if build_integer_key(instance, candidate.values, candidate.alternatives) == key
        )
        winner = next(winners, "relaxation")
    return Outcome(result, winner, len(candidates))


def solve_reduced(task: Task) -> Outcome:
    """Solve the reduced mixed-integer programs of the likeliest clusters, and make them exact."""
    settings = task.settings
    programs = task.kept.compute_once(REDUCED, lambda: build_reduced_programs(task))
    has_answer = [False]

    def candidates() -> Iterator[Candidate]:
        features = task.problem.feature_vector(task.theta)
        clusters, more = settings.neighbours or 1, _MORE_CLUSTERS
        return programs.candidates(
            task.instance, features, clusters, task.time_left, more, lambda: has_answer[0]
        )

    def check_candidate_point(instance: Instance, x: Array) -> CheckedPoint:
        verdict = task.check_point(instance, x)
        has_answer[0] = has_answer[0] or verdict.passed
        return verdict

    # The programs obey the time limit; the candidate of the last one is made exact in any case.
    return solve_candidates(
        replace(task, settings=replace(settings, solver=None)),
        candidates(),
        lambda k, _: f"candidate {k + 1} (reduce)",
        check=check_candidate_point,
        time_limit=np.inf,
    )


def build_reduced_programs(task: Task) -> ReducedPrograms:
    """Build the programs of the clusters of a task's model, for all instances of its problem."""
    settings, ranking = task.settings, task.read_clusters()
    grid, pieces = settings.envelopes.grid, settings.envelopes.pieces
    if grid is None:
        partitions = build_cluster_partitions(task.problem, task.instance, ranking.library, pieces)
        grid = McCormick(partitions)
    return ReducedPrograms(
        ranking,
        grid.partitions,
        grid.squares,
        solver=settings.solver or "highs",
        seconds=settings.time_limit,
    )


def build_cluster_partitions(
    problem: Problem, instance: Instance, library: Library, count: int
) -> tuple[Partition, ...]:
    """Build grids for reduced programs, the same for all parameters.

    They cover the stated bounds, and the range of solutions where there are none.
    """
    low, high = library.points.min(axis=0), library.points.max(axis=0)
    margin = 0.1 * np.maximum(high - low, 1e-3)
    lower = np.where(np.isfinite(instance.lower), instance.lower, low - margin)
    upper = np.where(np.isfinite(instance.upper), instance.upper, high + margin)
    products = instance.products
    box = VariableBox(
        lower, upper, compute_product_range(lower, upper, products.first, products.second)
    )
    return build_default_partitions(problem, instance, box, count)
