"""Training data of a strategy from datasets, plans, and scene files that are solved first."""

from __future__ import annotations

from pathlib import Path

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.methods.features import build_feature_map, compute_feature_scale
from climbplan.bookshelf.methods.library import (
    Priced,
    build_library,
    collect_placed_scenes,
    read_solved_scenes,
)
from climbplan.bookshelf.methods.mirror import SolvedScene
from climbplan.bookshelf.methods.shelf_context import build_context, require_context
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.bookshelf.scene import scene_file
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import build_theta
from climbplan.bookshelf.statement.statement import build_bookshelf_program
from climbplan.errors import UsageError
from climbplan.learning.clusters import select_solution_columns
from climbplan.learning.fit_run import TrainingData
from climbplan.progress import Progress
from climbplan.schema.learning.strategy_loading import LoadedStrategy
from climbplan.store.plan_format import read_plan_format


def collect_shelf_data(loaded: LoadedStrategy, report: Progress | None = None) -> TrainingData:
    """Collect the solved scenes that a spec names, all on one shelf in one meaning.

    Raises:
        PlanFileError: a file that is missing, damaged, or none of scenes.
        UsageError: files that do not go together, or no placement in them.
    """
    spec = loaded.spec.data
    scenes: list[Priced] = []
    first: tuple[Shelf, Meaning, int] | None = None
    for path in loaded.files:
        shelf, meaning, solved_scenes = _load_solved_scenes(path, report)
        if not solved_scenes:
            raise UsageError(f"{path}: no scene in it has a placement")
        count = solved_scenes[0].solved.scene.count
        if first is None:
            first = (shelf, meaning, count)
        require_context(
            build_context(*first, spec.features), shelf, meaning, count, loaded.files[0]
        )
        scenes += solved_scenes
    if first is None:
        raise UsageError("expected at least one file of solved scenes, got none")
    shelf, meaning, count = first
    scenes = scenes[: spec.size]
    program = build_bookshelf_program(count, shelf, meaning)
    # A mirrored scene stands on a mirrored shelf.
    mirror = spec.mirror and abs(shelf.left + shelf.right) < 1e-9
    rows = build_library(program, scenes, build_feature_map(spec.features, shelf), mirror)
    return TrainingData(
        library=rows.library,
        group=rows.scene,
        hard=rows.library.objective > TRIVIAL,
        columns=select_solution_columns(program.instantiate(build_theta(scenes[0].solved.scene))),
        context=build_context(shelf, meaning, count, spec.features),
        scale=compute_feature_scale(spec.features, count),
        hard_means=f"scenes that need more than {TRIVIAL:g} mm^2 of movement",
    )


def _load_solved_scenes(path: Path, report: Progress | None) -> tuple[Shelf, Meaning, list[Priced]]:
    if read_plan_format(path) == scene_file.FORMAT:
        return Shelf(), "contact", _solve_scene_file(path, report)
    plan = read_solved_scenes(path)
    meaning: Meaning = "published" if plan.meaning == "published" else "contact"
    return plan.shelf, meaning, collect_placed_scenes(plan)


def _solve_scene_file(path: Path, report: Progress | None) -> list[Priced]:
    """Solve the scenes of a file on the standard shelf."""
    scenes, solver = read_scenes(path), ExactSolver(Shelf(), ExactLimits())
    solved_scenes = []
    for k, scene in enumerate(scenes):
        if report is not None:
            report("solve scenes", k / len(scenes))
        answer = solver.solve(scene)
        if answer.placement is not None:
            solved_scenes.append(Priced(SolvedScene(scene, answer.placement), answer.objective))
    return solved_scenes
