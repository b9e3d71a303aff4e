"""`climbplan bench strategies`: trained strategies beside each other and beside `exact`.

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

from climbplan.bookshelf.benchmarks.inputs import FileGroup, Progress
from climbplan.bookshelf.exact import ExactSolver
from climbplan.bookshelf.features import feature_map, feature_scale
from climbplan.bookshelf.generator import DropRules, generate_scene, shelf_for
from climbplan.bookshelf.learned_methods import Convex
from climbplan.bookshelf.library import Priced, library_of, placed_scenes, solved_scenes
from climbplan.bookshelf.methods import MethodSetting
from climbplan.bookshelf.mirror import Solved
from climbplan.bookshelf.points import theta_of
from climbplan.bookshelf.scene import Array, Scene, Shelf
from climbplan.bookshelf.scene_file import read_scenes
from climbplan.bookshelf.shelf_context import context_of
from climbplan.bookshelf.statement_methods import Judge
from climbplan.bookshelf.summary import TRIVIAL
from climbplan.bookshelf.trained_methods import ReducedScenes, model_method
from climbplan.errors import UsageError
from climbplan.learning.clusters import ClusterOptions, solution_columns
from climbplan.learning.library import Library
from climbplan.learning.model import FitOptions, ModelKind, StrategyModel, fit
from climbplan.learning.ranking import RankedStrategies
from climbplan.learning.reduce import ClusterSolve
from climbplan.spec.bookshelf import ShelfSolverSpec

Contender = Literal["random", "knn", "forest", "boosting", "network", "reduce"]
CONTENDERS: tuple[Contender, ...] = ("random", "knn", "forest", "boosting", "network", "reduce")
CANDIDATES = (1, 3, 10, 20, 50)
STORED_BOOKS = 3
_LIBRARY_FROM = 1_000_000  # numbers of generated scenes that are trained on
_WITHIN, _SLACK = 1.01, 1e-3  # of the optimum, and [mm^2] for optima near zero
SETTINGS = {
    "same": DropRules(),
    "slender": DropRules(width_mm=(10, 20)),
    "narrow": DropRules(room_mm=160.0),
}
MEANT = {
    "same": "scenes like those trained on, none of them seen",
    "slender": "books 10 to 20 mm wide instead of 10 to 40, on the shelf that goes with them",
    "narrow": "a shelf 16 mm narrower",
}


@dataclass(frozen=True)
class StrategyOptions:
    """What is compared, and on how much."""

    seed: int = 0
    count: int = 60  # test scenes
    some: int = 12  # of them for `reduce`, which takes seconds a scene
    few: int = 30  # scenes of each other distribution
    seconds: float = 60.0  # limit of one scene
    library_size: int = 1000  # generated scenes
    scenes: str | None = None  # FILE[:GROUP]
    library: Path | None = None  # plan file or dataset
    methods: str | None = None  # comma-separated contenders


@dataclass(frozen=True)
class Figures:
    """One strategy on one set of scenes, without a fallback."""

    setting: str  # of SETTINGS
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


@dataclass(frozen=True)
class StrategyResult:
    """All figures, and what reduced programs took."""

    origin: str
    figures: list[Figures] = field(default_factory=list)
    clusters: list[ClusterSolve] = field(default_factory=list)


@dataclass(frozen=True)
class _Case:
    """Scenes with their optima."""

    setting: str
    scenes: Sequence[Scene]
    optimum: Array  # (S,) [mm^2]
    judge: Judge
    method: MethodSetting
    exact_ms: Array  # (S,)


def bench_strategies(options: StrategyOptions, report: Progress) -> StrategyResult:
    """Train on growing parts of the library, solve scenes that no strategy has seen.

    Raises:
        UsageError, PlanFileError: options or files that cannot be used.
        MissingSolver: scenes have to be generated, and pymunk is not installed.
    """
    chosen = _chosen(options.methods)
    shelf = shelf_for(STORED_BOOKS) if options.library is None else None
    training, shelf, origin = _training(options, shelf, report)
    cases = list(_cases(options, shelf, report))
    result = StrategyResult(origin)
    for case in cases:
        seconds = case.exact_ms / 1e3
        result.figures.append(_figures(case, "exact", 0, 0, case.optimum, seconds, 0.0))
    sizes = _sizes(len(training))
    for contender in chosen:
        for size in sizes if contender != "reduce" else sizes[-1:]:
            report(f"{contender}, {size} scenes", 0.0)
            begin = time.perf_counter()
            model = _model(contender, training[:size], shelf, options.seed)
            spent = time.perf_counter() - begin
            for case in cases if size == sizes[-1] else cases[:1]:
                if contender == "reduce":
                    result.figures.append(
                        _reduced(case, model, options, size, spent, result.clusters.append)
                    )
                else:
                    result.figures.extend(_ranked(contender, case, model, size, spent, options))
    return result


def as_json(result: StrategyResult, options: StrategyOptions) -> dict[str, Any]:
    """Everything as plain values; numbers that are not finite as null."""
    return {
        "benchmark": "strategies",
        "inputs": result.origin,
        "seed": options.seed,
        "settings": MEANT,
        "figures": [
            {
                key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in asdict(row).items()
            }
            for row in result.figures
        ],
        "reduced_programs": [asdict(solve) for solve in result.clusters],
    }


def _chosen(names: str | None) -> list[Contender]:
    if names is None:
        return list(CONTENDERS)
    wanted = [name.strip() for name in names.split(",")]
    unknown = [name for name in wanted if name not in CONTENDERS]
    if unknown:
        raise UsageError(
            f"bench strategies: no strategy {unknown[0]!r}, known are {', '.join(CONTENDERS)}"
        )
    return [name for name in CONTENDERS if name in wanted]


def _sizes(most: int) -> list[int]:
    """100, 300, 1000, ... and all."""
    steps = [k * 10**e for e in range(2, 7) for k in (1, 3)]
    return [*(size for size in steps if size < most), most]


def _training(
    options: StrategyOptions, shelf: Shelf | None, report: Progress
) -> tuple[list[Priced], Shelf, str]:
    if options.library is not None:
        plan = solved_scenes(options.library)
        solved = placed_scenes(plan)
        if plan.meaning != "contact" or not solved or plan.scenes.count != STORED_BOOKS:
            raise UsageError(
                f"{options.library}: expected placements of {STORED_BOOKS} stored books in the "
                "meaning `contact`"
            )
        # The order of a file may follow its origin: parts of it are to be alike.
        order = np.random.default_rng(options.seed).permutation(len(solved))
        name = options.library.name
        return [solved[k] for k in order], plan.shelf, f"{len(solved)} solved scenes of {name}"
    here = shelf or shelf_for(STORED_BOOKS)
    solver, solved = ExactSolver(here), []
    for k in range(options.library_size):
        scene = generate_scene(options.seed, _LIBRARY_FROM + k, STORED_BOOKS)
        answer = solver.solve(scene)
        report("library", (k + 1) / options.library_size)
        if answer.placement is not None:
            solved.append(Priced(Solved(scene, answer.placement), answer.objective))
    return solved, here, f"{len(solved)} generated and solved scenes, seed {options.seed}"


def _cases(options: StrategyOptions, shelf: Shelf, report: Progress) -> list[_Case]:
    out = []
    for setting, rules in SETTINGS.items():
        if setting == "same" and options.scenes is not None:
            place = FileGroup.of(options.scenes)
            found = read_scenes(place.path, place.group)
            scenes, here = [found[k] for k in range(min(options.count, len(found)))], shelf
        else:
            count = options.count if setting == "same" else options.few
            scenes = []
            for k in range(count):
                scenes.append(generate_scene(options.seed + 1, k, STORED_BOOKS, rules))
                report(f"scenes, {setting}", (k + 1) / count)
            here = shelf if setting == "same" else shelf_for(STORED_BOOKS, rules)
        if not scenes:
            continue
        solver = ExactSolver(here)
        solver.solve(scenes[0])  # compiles
        answers = [solver.solve(scene) for scene in scenes]
        placed = [k for k, answer in enumerate(answers) if answer.placement is not None]
        out.append(
            _Case(
                setting=setting,
                scenes=[scenes[k] for k in placed],
                optimum=np.array([answers[k].objective for k in placed]),
                judge=Judge(STORED_BOOKS, here, "contact"),
                method=MethodSetting(
                    here, "contact", ShelfSolverSpec(time_limit=options.seconds), Path()
                ),
                exact_ms=np.array([1e3 * answers[k].seconds for k in placed]),
            )
        )
    return out


def _model(
    contender: Contender, solved: Sequence[Priced], shelf: Shelf, seed: int
) -> StrategyModel:
    judge = Judge(STORED_BOOKS, shelf, "contact")
    library = library_of(judge.program, solved, feature_map("gaps", shelf)).library
    instance = judge.program.at(theta_of(solved[0].solved.scene))
    kind: ModelKind = "knn" if contender == "random" else contender
    least = max(2, min(10, library.size // 40))
    options = FitOptions(kind=kind, seed=seed, clusters=ClusterOptions(least=least))
    context = context_of(shelf, "contact", STORED_BOOKS, "gaps")
    scale = feature_scale("gaps", STORED_BOOKS)
    return fit(library, options, solution_columns(instance), scale, context)


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
    case: _Case,
    model: StrategyModel,
    rows: int,
    spent: float,
    options: StrategyOptions,
) -> list[Figures]:
    method = model_method(model, case.method, case.judge)
    if not isinstance(method, Convex):
        raise TypeError(f"a model of kind {model.kind!r} ranks no strategies")
    if contender == "random":
        chance = _Chance(model.library, np.random.default_rng(options.seed))
        method = replace(method, strategy=RankedStrategies(model.library, chance, model.scale))
    best = {most: np.full(len(case.scenes), np.inf) for most in CANDIDATES}
    taken = {most: np.zeros(len(case.scenes)) for most in CANDIDATES}
    method.tried(case.scenes[0])  # what is prepared once does not count
    for k, scene in enumerate(case.scenes):
        begin = time.perf_counter()
        found = method.tried(scene)
        whole = time.perf_counter() - begin
        each = np.array([tried.seconds for tried in found.tried])
        cost = np.array([tried.objective for tried in found.tried])
        for most in CANDIDATES:
            best[most][k] = cost[:most].min(initial=np.inf)
            taken[most][k] = whole - each[most:].sum()
    return [
        _figures(case, contender, rows, most, best[most], taken[most], spent) for most in CANDIDATES
    ]


def _reduced(
    case: _Case,
    model: StrategyModel,
    options: StrategyOptions,
    rows: int,
    spent: float,
    report: Callable[[ClusterSolve], None],
) -> Figures:
    hard = np.flatnonzero(case.optimum > TRIVIAL)
    rest = np.flatnonzero(case.optimum <= TRIVIAL)
    amount = options.some if case.setting == "same" else max(options.some // 3, 2)
    wanted = -(-amount // 2)
    chosen = np.sort(np.concatenate([hard[:wanted], rest[: amount - min(wanted, len(hard))]]))
    small = replace(
        case, scenes=[case.scenes[int(k)] for k in chosen], optimum=case.optimum[chosen]
    )
    method = model_method(model, case.method, case.judge)
    if not isinstance(method, ReducedScenes):
        raise TypeError(f"a model of kind {model.kind!r} has no reduced programs")
    method.programs.report = report
    cost, taken = np.full(len(chosen), np.inf), np.zeros(len(chosen))
    for k, scene in enumerate(small.scenes):
        begin = time.perf_counter()
        cost[k] = method.solve(scene).objective
        taken[k] = time.perf_counter() - begin
    return _figures(small, "reduce", rows, method.clusters, cost, taken, spent)


def _figures(
    case: _Case,
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
            judged = case.judge.judge_placement(case.scenes[int(k)], placement)
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
