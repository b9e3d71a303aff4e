"""`learned`: strategies against the default method on problems of several sorts.

Problems of each sort are drawn by its sampler and solved by the default method; a strategy of each
kind is trained on them. New problems are then solved by the default method, by the same method with
the strategy's integers first, and by the strategy alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np

from benchmarks.engine.shipped import shipped_cart_pole
from climbplan.api.strategy_comparison import StrategyComparison, compare_strategy
from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.instances.cart_pole import build_walled_cart_pole
from climbplan.instances.free_flyer import build_free_flyer_problem
from climbplan.learning.clusters import select_solution_columns
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import FitOptions, ModelKind, fit_strategy
from climbplan.methods.table import solve_instance
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem
from climbplan.program.statement import Program
from climbplan.progress import Progress

KINDS: tuple[ModelKind, ...] = ("knn", "forest", "network")
SOLVED, COMPARED = 200, 20
QUICK_SOLVED, QUICK_COMPARED = 8, 2
_STRIDE = 0.7  # longest step between stones [m]


@dataclass(frozen=True)
class _Sort:
    """Problems of one sort."""

    name: str
    what: str
    build: Callable[[], Problem]


def build_stone_problem(steps: int, stones: int, seed: int = 0) -> Problem:
    """Build a walk of point feet over random stones to a goal, with short steps."""
    rng = np.random.default_rng(seed)
    center = rng.uniform([0.0, -0.6], [4.5, 0.6], (stones, 2))
    half = rng.uniform(0.06, 0.14, (stones, 2))
    p = Program("stones")
    start, goal = p.parameter("start", (2,)), p.parameter("goal", (2,))
    foot = p.continuous("foot", (steps + 1, 2), -1.0, 5.0)
    p.equal("start", foot[0] - start)
    p.ball("stride", foot[1:] - foot[:-1], _STRIDE, unit="m")
    normals = np.vstack([np.eye(2), -np.eye(2)])
    places = [
        Polytope.halfspaces(f"stone{k}", normals, np.concatenate([c + h, h - c]))
        for k, (c, h) in enumerate(zip(center, half, strict=True))
    ]
    p.one_of("stones", foot[1:], [places] * steps)
    p.minimise("goal", 10.0 * np.sum((foot[-1] - goal) ** 2))
    p.minimise("effort", np.sum((foot[1:] - foot[:-1]) ** 2))

    def sample(rng: np.random.Generator) -> dict[str, Array]:
        return {
            "start": rng.uniform([-0.3, -0.4], [0.1, 0.4]),
            "goal": rng.uniform([3.0, -0.4], [4.2, 0.4]),
        }

    return Problem("stones", p, sample)


SORTS: tuple[_Sort, ...] = (
    _Sort(
        "cart-pole-10", "cart-pole between soft walls, 10 steps", lambda: build_walled_cart_pole(10)
    ),
    _Sort("cart-pole-20", "the same, 20 steps", lambda: build_walled_cart_pole(20)),
    _Sort("cart-pole-30", "the same, 30 steps", lambda: build_walled_cart_pole(30)),
    _Sort(
        "springs-30",
        "cart-pole between springs, 30 steps",
        lambda: shipped_cart_pole().long_springs(),
    ),
    _Sort(
        "free-flyer",
        "flyer among 8 rectangles, 5 steps",
        lambda: build_free_flyer_problem(np.random.default_rng(0), 5, 8),
    ),
    _Sort("stones", "8 steps over 120 stones", lambda: build_stone_problem(8, 120)),
)


def run_learned(
    seed: int,
    quick: bool,
    stream: TextIO,
    *,
    solved: int | None = None,
    compared: int | None = None,
    sorts: str | None = None,
    report: Progress = lambda stage, fraction: None,
) -> dict[str, Any]:
    """Print a table with one row for each sort of problems, strategy and way; return figures.

    Args:
        seed: Seed of problems and training.
        quick: Whether few problems are solved.
        stream: Takes the table.
        solved: Problems to learn from.
        compared: New problems.
        sorts: Names of sorts, by commas; all by default.
        report: Progress callback.

    Raises:
        UsageError: A sort is unknown.
    """
    solved = solved or (QUICK_SOLVED if quick else SOLVED)
    compared = compared or (QUICK_COMPARED if quick else COMPARED)
    selected = _select_sorts(sorts)
    rows: list[dict[str, Any]] = []
    print(
        f"{solved} solved problems to learn from, {compared} new ones; times are medians, costs "
        "are over those of the default method",
        file=stream,
    )
    for place, sort in enumerate(selected):
        problem = sort.build()
        theta = problem.sample_parameters(np.random.default_rng(seed))
        columns = select_solution_columns(problem.instance(theta))
        library, seconds = _build_library(problem, np.random.default_rng([seed, 0]), solved)
        facts = {"problem": sort.name, "strategies": len(library.strategies), "seconds": seconds}
        _write_head(
            f"{sort.what}: {len(library.strategies)} strategies, data in {seconds:.0f} s", stream
        )
        for number, kind in enumerate(KINDS):
            model = fit_strategy(library, FitOptions(kind=kind, seed=seed), columns)
            outcome = compare_strategy(problem, model, compared, seed=seed + 1)
            rows += [{**facts, **row} for row in _write_rows(sort, outcome, number == 0, stream)]
            report(sort.name, (place + (number + 1) / len(KINDS)) / len(selected))
    return {"rows": rows}


def _write_head(title: str, stream: TextIO) -> None:
    """Print the head of the table of one sort."""
    print(
        f"\n{title}\nproblem       way                   CPU [ms]  times as fast  answered  "
        "proved  worst cost  verdict",
        file=stream,
    )


def _select_sorts(names: str | None) -> tuple[_Sort, ...]:
    """Return sorts by their names, separated by commas."""
    if names is None:
        return SORTS
    by_name = {sort.name: sort for sort in SORTS}
    unknown = sorted(set(names.split(",")) - set(by_name))
    if unknown:
        raise UsageError(f"no sort {', '.join(unknown)}: expected some of {', '.join(by_name)}")
    return tuple(by_name[name] for name in names.split(","))


def _build_library(problem: Problem, rng: np.random.Generator, count: int) -> tuple[Library, float]:
    """Draw and solve problems; return those with an answer, and the time that this took [s]."""
    begin = time.perf_counter()
    thetas = [problem.sample_parameters(rng) for _ in range(count)]
    results = [(theta, solve_instance(problem, theta).result) for theta in thetas]
    answered = [(theta, result) for theta, result in results if result.x is not None]
    library = Library.of(
        ProgramSignature.of(problem.program),
        np.array([problem.feature_vector(theta) for theta, _ in answered]),
        np.array([result.x for _, result in answered]),
        np.array([result.objective for _, result in answered]),
        np.array([result.assignment for _, result in answered]),
    )
    return library, time.perf_counter() - begin


def _write_rows(
    sort: _Sort, outcome: StrategyComparison, is_first: bool, stream: TextIO
) -> list[dict[str, Any]]:
    """Print the rows of one strategy, after that of the default method, and return figures."""
    labels = {
        "default": outcome.default_method,
        "proposed": f"{outcome.default_method}, {outcome.kind} first",
        "alone": f"{outcome.kind} alone",
    }
    rows = []
    for way, label in labels.items():
        if way == "default" and not is_first:
            continue
        summary = outcome.summarise(way)
        verdict = "pays" if way != "default" and summary.pays else "-"
        ratio = summary.worst_cost_ratio
        print(
            f"{sort.name:<12}  {label:<20}  {1e3 * summary.cpu_seconds:8.1f}  "
            f"{summary.speedup:13.2f}  {summary.answered:8d}  {summary.proved:6d}  "
            f"{ratio:10.4f}  {verdict}",
            file=stream,
        )
        rows.append(
            {
                "problem": sort.name,
                "way": label,
                "cpu_seconds": summary.cpu_seconds,
                "seconds": summary.seconds,
                "speedup": summary.speedup,
                "answered": summary.answered,
                "proved": summary.proved,
                "worst_cost_ratio": ratio,
                "pays": summary.pays and way != "default",
            }
        )
    return rows
