"""Methods that keep integers: those given, those of neighbours, those that a model names."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.methods.envelope_rounds import (
    default_partitions,
)
from climbplan.methods.pinning import at_point, distinct, solve_candidate
from climbplan.methods.reduced_programs import ReducedPrograms
from climbplan.methods.task import Method, Outcome, Task, all_pinned, best
from climbplan.program.box import Box, product_range
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem
from climbplan.reformulations.grids import Partition
from climbplan.solvers.ipopt.instances import middle
from climbplan.solvers.result import Answer, SolverResult, judged

NEEDS_MODEL = ("forest", "boosting", "network", "reduce")
_MORE_CLUSTERS = 4  # of reduce, while none gave an answer


def pinned(task: Task) -> Outcome:
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
    return all_pinned(task, distinct(candidates, task.instance), origins)


def learned(method: Method) -> Callable[[Task], Outcome]:
    """The best of the integers that a strategy names."""

    def solve(task: Task) -> Outcome:
        if method in NEEDS_MODEL and task.settings.model is None:
            raise UsageError(
                f"method {method!r} needs a trained model: a model file of `climbplan fit-strategy`"
            )
        candidates = task.neighbours(method)
        origins = {}
        if task.settings.model is not None:
            origins = {id(c): f"candidate {k} ({method})" for k, c in enumerate(candidates, 1)}
        return all_pinned(task, candidates, origins)

    return solve


def reduce(task: Task) -> Outcome:
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
    return best(task, tried)


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
