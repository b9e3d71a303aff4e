"""What strategies are trained on and what they are measured on, scenes unlike the former apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.bookshelf.inputs import FileGroup
from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.features import build_feature_map, compute_feature_scale
from climbplan.bookshelf.methods.library import (
    Priced,
    SceneLibrary,
    build_library,
    collect_placed_scenes,
    find_mirror_axis,
    read_solved_scenes,
)
from climbplan.bookshelf.methods.mirror import SolvedScene
from climbplan.bookshelf.methods.placement_evaluator import PlacementEvaluator
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.shelf_context import build_context
from climbplan.bookshelf.scene.generator import DropRules, build_drop_shelf, generate_scene
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Shelf, ShelfScene
from climbplan.bookshelf.schema.model import ShelfSolverSpec
from climbplan.bookshelf.statement.points import build_theta
from climbplan.errors import UsageError
from climbplan.learning.clusters import ClusterOptions, select_solution_columns
from climbplan.learning.model import FitOptions, ModelKind, StrategyModel, fit_strategy
from climbplan.progress import Progress

STORED_BOOKS = 3
_LIBRARY_FROM = 1_000_000  # numbers of generated scenes that are trained on


@dataclass(frozen=True)
class SceneKind:
    """How test scenes come about."""

    meaning: str
    rules: DropRules = field(default_factory=DropRules)
    inserted_mm: tuple[int, int] | None = None  # width, drawn anew for the book that is inserted


SAME = "same"
KINDS = {
    SAME: SceneKind("scenes like those trained on, none of them seen"),
    # What is taken out of slender books fits back in nearly everywhere: a thick one does not.
    "slender": SceneKind(
        "stored books 10 to 20 mm wide instead of 10 to 40, the inserted one 40 to 70; same shelf",
        DropRules(width_mm=(10, 20), room_mm=176.0),
        (40, 70),
    ),
    "narrow": SceneKind("a shelf 16 mm narrower", DropRules(room_mm=160.0)),
}


@dataclass(frozen=True)
class Case:
    """Scenes with their optima."""

    setting: str  # of KINDS
    scenes: Sequence[ShelfScene]
    optimum: Array  # (S,) [mm^2]
    evaluator: PlacementEvaluator
    method: MethodSetting
    exact_ms: Array  # (S,)

    def part(self, rows: IntArray) -> Case:
        """Some of the scenes."""
        return Case(
            self.setting,
            [self.scenes[int(k)] for k in rows],
            self.optimum[rows],
            self.evaluator,
            self.method,
            self.exact_ms[rows],
        )


@dataclass(frozen=True)
class TrainingScenes:
    """Solved scenes as points of the statement, once for all models of one comparison."""

    rows: SceneLibrary
    count: int  # scenes; a mirror image is none of its own
    columns: IntArray  # variables that solutions are clustered by
    shelf: Shelf
    origin: str  # in words

    def model(self, kind: ModelKind, size: int, seed: int) -> StrategyModel:
        """A model of the first `size` scenes."""
        library = self.rows.library.subset(np.flatnonzero(self.rows.scene < size))
        least = max(2, min(10, library.size // 40))
        options = FitOptions(kind=kind, seed=seed, clusters=ClusterOptions(least=least))
        context = build_context(self.shelf, "contact", STORED_BOOKS, "gaps")
        return fit_strategy(
            library, options, self.columns, compute_feature_scale("gaps", STORED_BOOKS), context
        )


def training_scenes(source: Path | None, size: int, seed: int, report: Progress) -> TrainingScenes:
    """The solved scenes of a file, or generated ones solved by `exact`.

    Raises:
        UsageError, PlanFileError: a file that cannot be used.
        MissingSolver: scenes have to be generated, and pymunk is not installed.
    """
    if source is not None:
        plan = read_solved_scenes(source)
        solved = collect_placed_scenes(plan)
        if plan.meaning != "contact" or not solved or plan.scenes.count != STORED_BOOKS:
            raise UsageError(
                f"{source}: expected placements of {STORED_BOOKS} stored books in the meaning "
                "`contact`"
            )
        # The order of a file may follow its origin: parts of it are to be alike.
        order = np.random.default_rng(seed).permutation(len(solved))
        solved, shelf = [solved[k] for k in order], plan.shelf
        middle, origin = find_mirror_axis(plan), f"{len(solved)} solved scenes of {source.name}"
    else:
        shelf, middle = build_drop_shelf(STORED_BOOKS), 0.0
        scenes = _drawn(KINDS[SAME], seed, _LIBRARY_FROM, size, report, "library")
        solver = ExactSolver(shelf)
        answers = [(scene, solver.solve(scene)) for scene in scenes]
        solved = [
            Priced(SolvedScene(scene, answer.placement), answer.objective)
            for scene, answer in answers
            if answer.placement is not None
        ]
        origin = f"{len(solved)} generated and solved scenes, seed {seed}"
    report("points of the library", 0.0)
    evaluator = PlacementEvaluator(STORED_BOOKS, shelf, "contact")
    rows = build_library(evaluator.program, solved, build_feature_map("gaps", shelf), middle=middle)
    columns = select_solution_columns(
        evaluator.program.instantiate(build_theta(solved[0].solved.scene))
    )
    return TrainingScenes(rows, len(solved), columns, shelf, origin)


def unseen_cases(
    source: str | None,
    counts: Callable[[str], int],
    seed: int,
    shelf: Shelf,
    seconds: float,
    report: Progress,
) -> list[Case]:
    """Scenes of each kind and their optima; source: FILE[:GROUP] of scenes like those trained on.

    counts: scenes of a kind. seconds: limit of one scene.
    """
    cases = []
    for setting, kind in KINDS.items():
        if setting == SAME and source is not None:
            place = FileGroup.of(source)
            found = read_scenes(place.path, place.group)
            scenes = [found[k] for k in range(min(counts(setting), len(found)))]
        else:
            # Another seed: scenes of the library must not come again.
            scenes = _drawn(kind, seed + 1, 0, counts(setting), report, f"scenes, {setting}")
        here = shelf if setting == SAME else build_drop_shelf(STORED_BOOKS, kind.rules)
        if scenes:
            cases.append(case_of(setting, scenes, here, seconds))
    return cases


def case_of(setting: str, scenes: Sequence[ShelfScene], shelf: Shelf, seconds: float) -> Case:
    """The scenes that have a placement, with their optima by `exact`."""
    solver = ExactSolver(shelf)
    solver.solve(scenes[0])  # compiles
    answers = [solver.solve(scene) for scene in scenes]
    placed = [k for k, answer in enumerate(answers) if answer.placement is not None]
    return Case(
        setting=setting,
        scenes=[scenes[k] for k in placed],
        optimum=np.array([answers[k].objective for k in placed]),
        evaluator=PlacementEvaluator(STORED_BOOKS, shelf, "contact"),
        method=MethodSetting(shelf, "contact", ShelfSolverSpec(time_limit=seconds), Path()),
        exact_ms=np.array([1e3 * answers[k].seconds for k in placed]),
    )


def drawn_scenes(
    setting: str, seed: int, count: int, report: Progress, stage: str
) -> list[ShelfScene]:
    """Scenes of one kind; the same for the same seed."""
    return _drawn(KINDS[setting], seed, 0, count, report, stage)


def _drawn(
    kind: SceneKind, seed: int, first: int, count: int, report: Progress, stage: str
) -> list[ShelfScene]:
    scenes = []
    for k in range(count):
        scene = generate_scene(seed, first + k, STORED_BOOKS, kind.rules)
        if kind.inserted_mm is not None:
            rng = np.random.default_rng([seed, first + k])
            width = 1e-3 * rng.integers(*kind.inserted_mm, endpoint=True)
            scene = ShelfScene(scene.pose, scene.size, np.array([scene.inserted[0], width]))
        scenes.append(scene)
        report(stage, (k + 1) / count)
    return scenes
