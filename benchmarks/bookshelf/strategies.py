"""`strategies`: trained strategies beside each other and beside `exact`.

One run with the most candidates tells what fewer would have found: a candidate is only ever given
up for costing more than an earlier one. Scenes unlike those of the training data are reported
apart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.bookshelf.cluster_programs import ProgramTrial, cluster_programs
from benchmarks.bookshelf.strategy_cases import (
    KINDS,
    SAME,
    Case,
    TrainingScenes,
    case_of,
    drawn_scenes,
    training_scenes,
    unseen_cases,
)
from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.table_method import build_model_method, build_published_grid
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.learning.ranking import RankedStrategies
from climbplan.methods.fixed_integer_methods import REDUCED
from climbplan.methods.reduced_programs import ClusterSolve, ReducedPrograms
from climbplan.progress import Progress

Contender = Literal["random", "knn", "forest", "boosting", "network", "reduce"]
CONTENDERS: tuple[Contender, ...] = ("random", "knn", "forest", "boosting", "network", "reduce")
CANDIDATES = (1, 3, 10, 20, 50)
_POOL = 300  # scenes among which each cluster finds one that suits it
_WITHIN, _SLACK = 1.01, 1e-3  # of the optimum, and [mm^2] for optima near zero


@dataclass(frozen=True)
class StrategyOptions:
    """What is compared, and on how much."""

    seed: int = 0
    count: int = 100  # test scenes
    some: int = 20  # of them for `reduce`, which takes seconds a scene
    few: int = 60  # scenes of each other distribution
    clusters: int = 6  # whose programs HiGHS and SCIP solve
    seconds: float = 60.0  # limit of one scene, and of one mixed-integer program
    library_size: int = 1000  # generated scenes
    scenes: str | None = None  # FILE[:GROUP]
    library: Path | None = None  # plan file or dataset
    methods: str | None = None  # comma-separated contenders


@dataclass(frozen=True)
class Figures:
    """One strategy on one set of scenes, without a fallback."""

    setting: str  # of KINDS
    contender: str
    rows: int  # scenes it was trained on
    candidates: int  # of `reduce` clusters
    scenes: int
    success: float  # share with a placement that holds
    fallback: float  # share with one once `exact` answers the rest
    hard: int  # scenes that need movement
    within: float  # share of these within 1 % of the optimum; NaN of none
    deterioration: float  # [mm^2] mean cost above the optimum, of hard scenes solved
    ratio: float  # summed cost over summed optima, of hard scenes solved
    mean_ms: float
    most99_ms: float
    fit_seconds: float
    by_program: float = math.nan  # of `reduce`: share of placements that came from a program


@dataclass(frozen=True)
class StrategyResult:
    """All figures, what reduced programs took, and what each cluster's did."""

    origin: str
    figures: list[Figures] = field(default_factory=list)
    clusters: list[ClusterSolve] = field(default_factory=list)
    programs: list[ProgramTrial] = field(default_factory=list)


def bench_strategies(options: StrategyOptions, report: Progress) -> StrategyResult:
    """Train on growing parts of the library, solve scenes that no strategy has seen.

    Raises:
        UsageError, PlanFileError: options or files that cannot be used.
        MissingSolver: scenes have to be generated, and pymunk is not installed.
    """
    chosen = _chosen(options.methods)
    training = training_scenes(options.library, options.library_size, options.seed, report)
    cases = unseen_cases(
        options.scenes,
        lambda setting: options.count if setting == SAME else options.few,
        options.seed,
        training.shelf,
        options.seconds,
        report,
    )
    result = StrategyResult(training.origin)
    for case in cases:
        seconds = case.exact_ms / 1e3
        result.figures.append(_figures(case, "exact", 0, 0, case.optimum, seconds, 0.0))
    for contender in chosen:
        _contender(contender, training, cases, options, result, report)
    return result


def _contender(
    contender: Contender,
    training: TrainingScenes,
    cases: Sequence[Case],
    options: StrategyOptions,
    result: StrategyResult,
    report: Progress,
) -> None:
    sizes = _sizes(training.count)
    if contender == "random":  # does not learn
        sizes = sizes[-1:]
    elif contender == "reduce":  # takes seconds a scene
        sizes = [*sizes[-3::-2][::-1], sizes[-1]]
    for size in sizes:
        report(f"{contender}, {size} scenes", 0.0)
        begin = time.perf_counter()
        kind = "knn" if contender == "random" else contender
        model = training.model(kind, size, options.seed)
        spent = time.perf_counter() - begin
        last = size == sizes[-1]
        for case in cases if last else cases[:1]:
            if contender == "reduce":
                row = _reduced(case, model, options, size, spent, result.clusters.append)
                result.figures.append(row)
            else:
                result.figures.extend(_ranked(contender, case, model, size, spent, options))
        if contender == "reduce" and last and options.clusters:
            scenes = drawn_scenes(SAME, options.seed + 2, _POOL, report, "scenes for clusters")
            pool = case_of(SAME, scenes, training.shelf, options.seconds)
            result.programs.extend(
                cluster_programs(
                    pool, model, options.clusters, options.seconds, options.seed, report
                )
            )


def as_json(result: StrategyResult) -> dict[str, Any]:
    """Return all figures as plain values."""
    return {
        "inputs": result.origin,
        "settings": {setting: kind.meaning for setting, kind in KINDS.items()},
        "figures": [asdict(row) for row in result.figures],
        "reduced_programs": [asdict(solve) for solve in result.clusters],
        "cluster_programs": [asdict(trial) for trial in result.programs],
    }


def _chosen(names: str | None) -> list[Contender]:
    if names is None:
        return list(CONTENDERS)
    wanted = [name.strip() for name in names.split(",")]
    unknown = [name for name in wanted if name not in CONTENDERS]
    if unknown:
        raise UsageError(
            f"--methods: no strategy {unknown[0]!r}, known are {', '.join(CONTENDERS)}"
        )
    return [name for name in CONTENDERS if name in wanted]


def _sizes(most: int) -> list[int]:
    """100, 300, 1000, ... and all."""
    steps = [k * 10**e for e in range(2, 7) for k in (1, 3)]
    return [*(size for size in steps if size < most), most]


@dataclass(frozen=True)
class _Chance:
    """Strategies in no order: the published baseline."""

    library: Library
    rng: np.random.Generator

    def probabilities(self, features: Array) -> Array:
        value = self.rng.uniform(0.5, 1.0, len(self.library.strategies))
        return np.asarray(value / value.sum())


def _ranked(
    contender: Contender,
    case: Case,
    model: StrategyModel,
    rows: int,
    spent: float,
    options: StrategyOptions,
) -> list[Figures]:
    method = build_model_method(model, case.method, case.evaluator)
    if contender == "random":
        chance = _Chance(model.library, np.random.default_rng(options.seed))
        ranked = RankedStrategies(model.library, chance, model.scale)
        method = replace(method, settings=replace(method.settings, strategy=ranked))
    best = {most: np.full(len(case.scenes), np.inf) for most in CANDIDATES}
    taken = {most: np.zeros(len(case.scenes)) for most in CANDIDATES}
    method.find_candidates(case.scenes[0])  # what is prepared once does not count
    for k, scene in enumerate(case.scenes):
        begin = time.perf_counter()
        fates = method.find_candidates(scene).fates
        whole = time.perf_counter() - begin
        each = np.array([tried.seconds for tried in fates])
        cost = np.array([tried.objective for tried in fates])
        for most in CANDIDATES:
            best[most][k] = cost[:most].min(initial=np.inf)
            taken[most][k] = whole - each[most:].sum()
    return [
        _figures(case, contender, rows, most, best[most], taken[most], spent) for most in CANDIDATES
    ]


def _reduced(
    case: Case,
    model: StrategyModel,
    options: StrategyOptions,
    rows: int,
    spent: float,
    report: Callable[[ClusterSolve], None],
) -> Figures:
    chosen = _halves(case, options.some if case.setting == SAME else max(options.some // 2, 2))
    small = case.part(chosen)
    method = build_model_method(model, case.method, case.evaluator)
    grid = build_published_grid(case.evaluator)
    programs = ReducedPrograms(
        model.create_cluster_ranking(),
        grid.partitions,
        grid.squares,
        seconds=method.settings.time_limit,
        report=report,
    )
    method.cache.compute_once(REDUCED, lambda: programs)
    cost, taken = np.full(len(chosen), np.inf), np.zeros(len(chosen))
    by_program = 0
    for k, scene in enumerate(small.scenes):
        begin = time.perf_counter()
        fates = method.find_candidates(scene).fates
        taken[k] = time.perf_counter() - begin
        winner = min(fates, key=lambda tried: tried.objective, default=None)
        if winner is None or not winner.passed:
            continue
        cost[k] = winner.objective
        # Strategies that only follow a program have no score.
        by_program += math.isfinite(winner.candidate.score)
    clusters = method.settings.neighbours or 1
    row = _figures(small, "reduce", rows, clusters, cost, taken, spent)
    return replace(row, by_program=by_program / max(np.isfinite(cost).sum(), 1))


def _halves(case: Case, amount: int) -> IntArray:
    """Scenes that need movement and scenes that need none, as nearly as many of each as there
    are."""
    hard = np.flatnonzero(case.optimum > TRIVIAL)
    rest = np.flatnonzero(case.optimum <= TRIVIAL)
    few = min(len(hard), max(-(-amount // 2), amount - len(rest)))
    return np.sort(np.concatenate([hard[:few], rest[: amount - few]]))


def _figures(
    case: Case,
    contender: str,
    rows: int,
    candidates: int,
    cost: Array,
    seconds: Array,
    spent: float,
) -> Figures:
    placed = np.isfinite(cost)
    solver = ExactSolver(case.method.shelf)
    rescued = 0
    for k in np.flatnonzero(~placed):
        placement = solver.solve(case.scenes[int(k)]).placement
        if placement is not None:
            judged = case.evaluator.evaluate_placement(case.scenes[int(k)], placement)
            rescued += judged.placement is not None
    hard = case.optimum > TRIVIAL
    both = hard & placed
    near = cost[hard] <= _WITHIN * case.optimum[hard] + _SLACK
    return Figures(
        setting=case.setting,
        contender=contender,
        rows=rows,
        candidates=candidates,
        scenes=len(cost),
        success=float(placed.mean()),
        fallback=float((placed.sum() + rescued) / len(cost)),
        hard=int(hard.sum()),
        within=float(near.mean()) if hard.any() else math.nan,
        deterioration=float((cost - case.optimum)[both].mean()) if both.any() else math.nan,
        ratio=float(cost[both].sum() / case.optimum[both].sum()) if both.any() else math.nan,
        mean_ms=float(1e3 * seconds.mean()),
        most99_ms=float(1e3 * np.quantile(seconds, 0.99)),
        fit_seconds=spent,
    )
