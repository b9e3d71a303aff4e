"""Methods that keep integers: those given, those of neighbours, those that a model names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.strategy import Candidate
from climbplan.methods.envelope_rounds import default_partitions
from climbplan.methods.pinning import at_point, distinct
from climbplan.methods.pipeline import Checked
from climbplan.methods.reduced_programs import ReducedPrograms
from climbplan.methods.task import Method, Outcome, Task, all_pinned, origin_of
from climbplan.program.box import Box, product_range
from climbplan.program.instance import Instance
from climbplan.program.problem import Problem
from climbplan.reformulations.grids import Partition
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.ipopt.instances import middle

NEEDS_MODEL = ("forest", "boosting", "network", "reduce")
REDUCED = "reduced programs"  # what `Kept` has them by
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
    return all_pinned(
        task,
        distinct(candidates, task.instance),
        lambda place, candidate: origins.get(id(candidate)) or origin_of(place, candidate),
    )


def learned(method: Method) -> Callable[[Task], Outcome]:
    """The best of the integers that a strategy names."""

    def solve(task: Task) -> Outcome:
        settings = task.settings
        if method in NEEDS_MODEL and settings.model is None and settings.strategy is None:
            raise UsageError(
                f"method {method!r} needs a trained model: a model file of `climbplan fit-strategy`"
            )
        named = settings.model is not None
        return all_pinned(
            task,
            task.neighbours(method),
            lambda k, c: f"candidate {k + 1} ({method})" if named else origin_of(k, c),
        )

    return solve


def reduce(task: Task) -> Outcome:
    """The reduced mixed-integer programs of the likeliest clusters, made exact."""
    settings = task.settings
    programs = task.kept.once(REDUCED, lambda: reduced_programs(task))
    held = [False]

    def candidates() -> Iterator[Candidate]:
        features = task.problem.feature_vector(task.theta)
        clusters, more = settings.neighbours or 1, _MORE_CLUSTERS
        return programs.candidates(
            task.instance, features, clusters, task.left, more, lambda: held[0]
        )

    def checked(instance: Instance, x: Array) -> Checked:
        verdict = task.checked(instance, x)
        held[0] = held[0] or verdict.passed
        return verdict

    # The programs keep the time limit; what the last one found is made exact in any case.
    return all_pinned(
        replace(task, settings=replace(settings, solver=None)),
        candidates(),
        lambda k, _: f"candidate {k + 1} (reduce)",
        check=checked,
        time_limit=np.inf,
    )


def reduced_programs(task: Task) -> ReducedPrograms:
    """The programs of the clusters of a task's model, for all instances of its problem."""
    settings, ranking = task.settings, task.clusters()
    grid, pieces = settings.envelopes.grid, settings.envelopes.pieces
    if grid is None:
        partitions = cluster_partitions(task.problem, task.instance, ranking.library, pieces)
        grid = McCormick(partitions)
    return ReducedPrograms(
        ranking,
        grid.partitions,
        grid.squares,
        solver=settings.solver or "highs",
        seconds=settings.time_limit,
    )


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
