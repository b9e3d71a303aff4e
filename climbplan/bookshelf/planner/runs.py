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

from climbplan.bookshelf.check.checker import book_names
from climbplan.bookshelf.check.meanings import check_placements, fit_side_by_side
from climbplan.bookshelf.exact.method import compile_once
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare
from climbplan.bookshelf.plan.answer import SceneAnswer, Status
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, Solutions, totals_of
from climbplan.bookshelf.plan.summary import summary_lines
from climbplan.bookshelf.scene.oddities import oddities
from climbplan.bookshelf.scene.scene_source import loaded_scenes, shelf_of
from climbplan.bookshelf.scene.shelf_scene import Scene, Scenes, Shelf, movement_cost
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.errors import Conflict, Infeasible, LimitReached, Remedy
from climbplan.progress import Progress


def save_scene_model(setting: MethodSetting, scene: Scene, path: Path) -> None:
    """Write what a method solves for a scene.

    `micp` and `admm`: the mixed-integer program over the envelopes, as .lp, .mps or .cip. Other
    methods: the whole statement with its products, as SCIP's .cip. Raises UsageError for another
    suffix or an unwritable place, MissingSolver without PySCIPOpt.
    """
    # These load CasADi and SCIP: not before they are needed.
    from climbplan.bookshelf.methods.by_table import published_grid
    from climbplan.bookshelf.methods.judge import Judge
    from climbplan.reformulations.disjunctions import BigM
    from climbplan.solvers.model_file import save_model
    from climbplan.solvers.scip.bilinear import save_bilinear_model

    solver = setting.solver
    judge = Judge(scene.count, setting.shelf, setting.meaning)
    instance = judge.instance(scene)
    if solver.method not in ("micp", "admm"):
        save_bilinear_model(instance, path)
        return
    enveloped = published_grid(judge).apply(instance)
    save_model(BigM().apply(enveloped.instance).instance, path)


_COMPILED = (
    "exact",
    "knn",
    "forest",
    "boosting",
    "network",
    "reduce",
)  # methods whose first scene would pay for the compilation
_CHUNKS = 16  # a worker gets its share of scenes in about so many pieces


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
    report = report or _silent
    scenes, shelf = loaded_scenes(loaded), shelf_of(loaded.spec.shelf)
    odd = oddities(scenes, shelf)
    for line in odd:
        if warn is not None:
            warn(line)
    setting = MethodSetting.of(loaded.spec, shelf, loaded.directory)
    if save_model is not None:
        save_scene_model(setting, scenes[0], save_model)
    start = time.perf_counter()
    report("prepare", 0.0)
    compile_first(setting)
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
        meaning=loaded.spec.meaning,
        method=solver.method,
        scenes=scenes,
        solutions=solutions,
        totals=totals_of(solutions),
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        timings={"prepare": ready - start, "solve": solved - ready},
        solvers=_solvers(loaded),
        sizes={
            "scenes": len(scenes),
            "stored books": scenes.count,
            "placements": int(solutions.placed.sum()),
            "nodes": int(solutions.nodes.sum()),
            "candidates": int(solutions.candidates_tried.sum()),
        },
        warnings=odd,
    )
    return replace(plan, summary=summary_lines(plan))


def solve_scenes(
    scenes: Scenes, setting: MethodSetting, jobs: int = 1, report: Progress | None = None
) -> list[SceneAnswer]:
    """Answers to all scenes, in their order, each through the exact check of the meaning.

    The answers do not depend on the number of workers, but for times and what a time limit cuts
    off; each worker prepares its own method once.
    """
    report = report or _silent
    answers: list[SceneAnswer] = []
    for part in _parts(scenes, setting, min(jobs, len(scenes))):
        answers += part
        report("solve", len(answers) / len(scenes))
    return checked(scenes, answers, setting)


def checked(
    scenes: Scenes, answers: Sequence[SceneAnswer], setting: MethodSetting
) -> list[SceneAnswer]:
    """The answers; one that breaks a constraint counts as none, whatever its solver said.

    Costs are those of the poses; a bound above its cost is none, and `optimal` is what is within
    the gap that was asked for.
    """
    result = list(answers)
    fits = fit_side_by_side(scenes, setting.shelf)
    for k, answer in enumerate(answers):
        if answer.status == "infeasible" and setting.meaning == "contact" and fits[k]:
            word = "the method says infeasible, but all books fit side by side"
            result[k] = replace(answer, status="limit", bound=-math.inf, shortage=None, word=word)
    placed = [k for k, answer in enumerate(answers) if answer.placement is not None]
    if not placed:
        return result
    rows = np.array(placed)
    placements = [p for answer in answers if (p := answer.placement) is not None]
    chosen = Scenes(scenes.pose[rows], scenes.size[rows], scenes.inserted[rows])
    pose = np.stack([p.pose for p in placements])
    state = np.stack([p.state for p in placements])
    check = check_placements(chosen, pose, state, setting.shelf, setting.meaning)
    cost = movement_cost(chosen, pose)
    for row, scene in enumerate(placed):
        broken = check.explain(row).replace("\n", "; ")
        result[scene] = (
            _refused(answers[scene], broken)
            if broken
            else _priced(answers[scene], float(cost[row]), setting)
        )
    return result


def _refused(answer: SceneAnswer, broken: str) -> SceneAnswer:
    return replace(
        answer,
        status="limit",
        placement=None,
        objective=math.inf,
        word=f"the method's answer breaks {broken}",
    )


def _priced(answer: SceneAnswer, cost: float, setting: MethodSetting) -> SceneAnswer:
    """With the cost of its pose and what its bound then proves."""
    solver, bound, word = setting.solver, answer.bound, answer.word
    allowed = max(solver.gap_mm2, solver.gap * cost)
    if bound - cost > allowed:
        remark = f"the bound {bound:.6g} mm^2 of the solver is above the cost, and so not valid"
        bound, word = -math.inf, "; ".join(filter(None, (word, remark)))
    bound = min(bound, cost)
    proved = answer.status == "optimal" and cost - bound <= allowed * (1 + 1e-6)
    status: Status = "optimal" if proved else "feasible"
    return replace(answer, status=status, objective=cost, bound=bound, word=word)


def compile_first(setting: MethodSetting) -> None:
    """Compile what a method needs, or read it from the cache, before any clock of a scene runs."""
    if setting.solver.method in _COMPILED:
        compile_once()


def _parts(scenes: Scenes, setting: MethodSetting, jobs: int) -> Iterator[list[SceneAnswer]]:
    if jobs == 1:
        method = prepare(setting, scenes.count)
        for scene in scenes:
            yield [method.solve(scene)]
        return
    pieces = np.array_split(np.arange(len(scenes)), min(len(scenes), _CHUNKS * jobs))
    yield from Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_solve_part)([scenes[int(k)] for k in piece], setting) for piece in pieces
    )


def _solve_part(scenes: list[Scene], setting: MethodSetting) -> list[SceneAnswer]:
    """In a worker, which keeps its method."""
    method = _prepared(setting, scenes[0].count)
    return [method.solve(scene) for scene in scenes]


@lru_cache(maxsize=1)
def _prepared(setting: MethodSetting, count: int) -> SceneMethod:
    compile_first(setting)
    return prepare(setting, count)


def _require_placement(answer: SceneAnswer, scene: Scene, shelf: Shelf) -> None:
    if answer.status == "infeasible":
        raise Infeasible(
            "no placement exists (proved)", [_conflict(answer, scene, shelf)], stage="solve"
        )
    if answer.placement is None:
        why = answer.word or f"time or node limit reached after {answer.seconds:.2g} s"
        raise LimitReached(f"no placement found: {why}", stage="solve")


def _at_least(key: str, value: float) -> Remedy:
    """A key of the shelf [mm] and the hundredth that is enough."""
    enough = math.ceil(100 * value - 1e-6) / 100
    return Remedy(f"{key} >= {enough:.2f}", f"shelf.{key}", enough)


def _conflict(answer: SceneAnswer, scene: Scene, shelf: Shelf) -> Conflict:
    """What the shelf misses, and what would be enough."""
    shortage = answer.shortage
    if shortage is None:
        return Conflict("shelf", (answer.word or "no state of the books fits",), in_words=True)
    if shortage.height > 0:
        least = scene.sizes.min(axis=1)
        books = [
            name
            for name, side in zip(book_names(scene.count), least, strict=True)
            if side > shelf.height
        ]
        needed = _at_least("height_mm", 1e3 * float(least.max()))
        words = f"{shortage} ({' and '.join(books)})"
        return Conflict(f"clear height of {1e3 * shelf.height:.2f} mm", (words,), (needed,), True)
    tall, thick = 1e3 * scene.inserted
    words = f"{shortage} for {scene.count} stored books and one of {tall:g} x {thick:g} mm"
    needed = _at_least("right_mm", 1e3 * (shelf.right + shortage.width))
    return Conflict(f"width of {1e3 * shelf.width:.2f} mm", (words,), (needed,), in_words=True)


def _solvers(loaded: LoadedShelf) -> dict[str, Any]:
    solver = loaded.spec.solver
    used: dict[str, Any] = {"method": solver.method}
    if solver.solver is not None:
        used["solver"] = solver.solver
    if solver.method in _COMPILED:
        used["numba"] = metadata.version("numba")
    return used


def _silent(stage: str, fraction: float) -> None:
    pass
