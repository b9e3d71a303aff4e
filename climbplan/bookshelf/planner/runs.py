"""All scenes of a spec by one method, on any number of workers, each answer checked."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from climbplan.bookshelf.check.checker import name_books
from climbplan.bookshelf.check.meanings import check_placements, fit_side_by_side
from climbplan.bookshelf.exact.method import compile_once
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare_method
from climbplan.bookshelf.plan.answer import SceneAnswer, Status
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, Solutions, compute_totals
from climbplan.bookshelf.plan.summary import build_summary_lines
from climbplan.bookshelf.scene.oddities import find_oddities
from climbplan.bookshelf.scene.scene_source import build_shelf, load_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.errors import Conflict, Infeasible, LimitReached, Remedy
from climbplan.progress import Progress


def save_scene_model(setting: MethodSetting, scene: ShelfScene, path: Path) -> None:
    """Write the program that a method solves for a scene.

    `mccormick` and `admm` write the mixed-integer program over the envelopes, as .lp, .mps or .cip.
    Other methods write the whole statement with its products, as SCIP's .cip.

    Raises:
        UsageError: another suffix or an unwritable path.
        MissingSolver: PySCIPOpt is not installed.
    """
    # These load CasADi and SCIP: not before they are needed.
    from climbplan.bookshelf.methods.placement_evaluator import PlacementEvaluator
    from climbplan.bookshelf.methods.table_method import build_published_grid
    from climbplan.reformulations.disjunctions import BigM
    from climbplan.solvers.model_file import save_model
    from climbplan.solvers.scip.bilinear import save_bilinear_model

    solver = setting.solver
    evaluator = PlacementEvaluator(scene.count, setting.shelf, setting.meaning)
    instance = evaluator.instance(scene)
    if solver.method not in ("mccormick", "admm"):
        save_bilinear_model(instance, path)
        return
    enveloped = build_published_grid(evaluator).apply(instance)
    save_model(BigM().apply(enveloped.instance).instance, path)


_COMPILED = (
    "exact",
    "knn",
    "forest",
    "boosting",
    "network",
    "reduce",
)  # methods whose first scene would pay for the compilation
_CHUNKS = 16  # pieces in which a worker receives its scenes, about


def run_shelf(
    loaded: LoadedShelf,
    report: Progress | None = None,
    jobs: int = 1,
    warn: Callable[[str], None] | None = None,
    save_model: Path | None = None,
) -> ShelfPlan:
    """Solve all scenes of a spec.

    A scene without a placement is a row of the plan, unless it is the only scene. `warn` is called
    with each oddity of the stored scenes before they are solved; the program of the first scene is
    written to `save_model`.

    Raises:
        SpecError: a scene file that cannot be used.
        UsageError: a method that does not go with the spec; MissingSolver if it is not installed.
        Infeasible, LimitReached: the only scene has no placement, or none was found.
    """
    report = report or _ignore_progress
    scenes, shelf = load_scenes(loaded), build_shelf(loaded.spec.shelf)
    warnings = find_oddities(scenes, shelf)
    for line in warnings:
        if warn is not None:
            warn(line)
    setting = MethodSetting.of(loaded.spec, shelf, loaded.directory)
    if save_model is not None:
        save_scene_model(setting, scenes[0], save_model)
    start = time.perf_counter()
    report("prepare", 0.0)
    compile_solver(setting)
    ready = time.perf_counter()
    answers = solve_scenes(scenes, setting, jobs, report)
    solved = time.perf_counter()
    if len(scenes) == 1:
        _require_placement(answers[0], scenes[0], shelf)
    solutions = Solutions.of(scenes, answers)
    solver = loaded.spec.solver
    plan = ShelfPlan(
        name=loaded.name,
        title=loaded.spec.title,
        shelf=shelf,
        meaning=loaded.spec.formulation,
        method=solver.method,
        scenes=scenes,
        solutions=solutions,
        totals=compute_totals(solutions),
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        timings={"prepare": ready - start, "solve": solved - ready},
        solvers=_describe_solvers(loaded),
        sizes={
            "scenes": len(scenes),
            "stored books": scenes.count,
            "placements": int(solutions.placed.sum()),
            "nodes": int(solutions.nodes.sum()),
            "candidates": int(solutions.candidates_tried.sum()),
        },
        warnings=warnings,
    )
    return replace(plan, summary=build_summary_lines(plan))


def solve_scenes(
    scenes: Scenes, setting: MethodSetting, jobs: int = 1, report: Progress | None = None
) -> list[SceneAnswer]:
    """Answers to all scenes, in their order, each through the exact check of the meaning.

    The answers do not depend on the number of workers, but for times and what a time limit cuts
    off; each worker prepares its own method once.
    """
    report = report or _ignore_progress
    answers: list[SceneAnswer] = []
    for chunk in _solve_chunks(scenes, setting, min(jobs, len(scenes))):
        answers += chunk
        report("solve", len(answers) / len(scenes))
    return check_answers(scenes, answers, setting)


def check_answers(
    scenes: Scenes, answers: Sequence[SceneAnswer], setting: MethodSetting
) -> list[SceneAnswer]:
    """Check answers: one that violates a constraint counts as none, whatever its solver reports.

    Costs are computed from the poses. A bound above its cost is dropped. `optimal` requires that
    the gap is within that of the solver options.
    """
    result = list(answers)
    fits = fit_side_by_side(scenes, setting.shelf)
    for k, answer in enumerate(answers):
        if answer.status == "infeasible" and setting.meaning == "contact" and fits[k]:
            message = "the method says infeasible, but all books fit side by side"
            result[k] = replace(
                answer, status="limit", bound=-math.inf, shortage=None, message=message
            )
    placed = [k for k, answer in enumerate(answers) if answer.placement is not None]
    if not placed:
        return result
    rows = np.array(placed)
    placements = [p for answer in answers if (p := answer.placement) is not None]
    chosen = Scenes(scenes.pose[rows], scenes.size[rows], scenes.inserted[rows])
    pose = np.stack([p.pose for p in placements])
    state = np.stack([p.state for p in placements])
    check = check_placements(chosen, pose, state, setting.shelf, setting.meaning)
    cost = compute_movement_cost(chosen, pose)
    for row, scene in enumerate(placed):
        broken = check.explain(row).replace("\n", "; ")
        result[scene] = (
            _reject_answer(answers[scene], broken)
            if broken
            else _update_cost_and_bound(answers[scene], float(cost[row]), setting)
        )
    return result


def _reject_answer(answer: SceneAnswer, broken: str) -> SceneAnswer:
    return replace(
        answer,
        status="limit",
        placement=None,
        objective=math.inf,
        message=f"the method's answer breaks {broken}",
    )


def _update_cost_and_bound(answer: SceneAnswer, cost: float, setting: MethodSetting) -> SceneAnswer:
    """Replace the cost by that of the pose, and the status by what the bound then proves."""
    solver, bound, message = setting.solver, answer.bound, answer.message
    allowed = max(solver.gap_mm2, solver.gap * cost)
    if bound - cost > allowed:
        remark = f"the bound {bound:.6g} mm^2 of the solver is above the cost, and so not valid"
        bound, message = -math.inf, "; ".join(filter(None, (message, remark)))
    bound = min(bound, cost)
    proved = answer.status == "optimal" and cost - bound <= allowed * (1 + 1e-6)
    status: Status = "optimal" if proved else "feasible"
    return replace(answer, status=status, objective=cost, bound=bound, message=message)


def compile_solver(setting: MethodSetting) -> None:
    """Compile the functions of a method, or read them from the cache, before scenes are timed."""
    if setting.solver.method in _COMPILED:
        compile_once()


def _solve_chunks(scenes: Scenes, setting: MethodSetting, jobs: int) -> Iterator[list[SceneAnswer]]:
    if jobs == 1:
        method = prepare_method(setting, scenes.count)
        for scene in scenes:
            yield [method.solve(scene)]
        return
    pieces = np.array_split(np.arange(len(scenes)), min(len(scenes), _CHUNKS * jobs))
    yield from Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_solve_chunk)([scenes[int(k)] for k in piece], setting) for piece in pieces
    )


def _solve_chunk(scenes: list[ShelfScene], setting: MethodSetting) -> list[SceneAnswer]:
    """Solve scenes in a worker process, which caches its method."""
    method = _prepare_cached_method(setting, scenes[0].count)
    return [method.solve(scene) for scene in scenes]


@lru_cache(maxsize=1)
def _prepare_cached_method(setting: MethodSetting, count: int) -> SceneMethod:
    compile_solver(setting)
    return prepare_method(setting, count)


def _require_placement(answer: SceneAnswer, scene: ShelfScene, shelf: Shelf) -> None:
    if answer.status == "infeasible":
        raise Infeasible(
            "no placement exists (proved)", [_build_conflict(answer, scene, shelf)], stage="solve"
        )
    if answer.placement is None:
        why = answer.message or f"time or node limit reached after {answer.seconds:.2g} s"
        raise LimitReached(f"no placement found: {why}", stage="solve")


def _build_remedy(key: str, value: float) -> Remedy:
    """Build a remedy from a key of the shelf and its smallest sufficient value [mm]."""
    threshold = math.ceil(100 * value - 1e-6) / 100
    return Remedy(f"{key} >= {threshold:.2f}", f"shelf.{key}", threshold)


def _build_conflict(answer: SceneAnswer, scene: ShelfScene, shelf: Shelf) -> Conflict:
    """Build the conflict of an infeasible scene with a sufficient size of the shelf."""
    shortage = answer.shortage
    if shortage is None:
        return Conflict("shelf", (answer.message or "no state of the books fits",), in_words=True)
    if shortage.height > 0:
        smaller_sides = scene.sizes.min(axis=1)
        books = [
            name
            for name, side in zip(name_books(scene.count), smaller_sides, strict=True)
            if side > shelf.height
        ]
        needed = _build_remedy("height_mm", 1e3 * float(smaller_sides.max()))
        description = f"{shortage} ({' and '.join(books)})"
        return Conflict(
            f"clear height of {1e3 * shelf.height:.2f} mm", (description,), (needed,), True
        )
    tall, thick = 1e3 * scene.inserted
    description = f"{shortage} for {scene.count} stored books and one of {tall:g} x {thick:g} mm"
    needed = _build_remedy("right_mm", 1e3 * (shelf.right + shortage.width))
    return Conflict(
        f"width of {1e3 * shelf.width:.2f} mm", (description,), (needed,), in_words=True
    )


def _describe_solvers(loaded: LoadedShelf) -> dict[str, Any]:
    solver = loaded.spec.solver
    solvers: dict[str, Any] = {"method": solver.method}
    if solver.solver is not None:
        solvers["solver"] = solver.solver
    if solver.method in _COMPILED:
        solvers["numba"] = metadata.version("numba")
    return solvers


def _ignore_progress(stage: str, fraction: float) -> None:
    pass
