"""Solved scenes for a strategy: from datasets and plans, and from scene files solved first."""

from __future__ import annotations

from pathlib import Path

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.methods.features import feature_map, feature_scale
from climbplan.bookshelf.methods.library import Priced, library_of, placed_scenes, solved_scenes
from climbplan.bookshelf.methods.mirror import Solved
from climbplan.bookshelf.methods.shelf_context import context_of, require_context
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.bookshelf.scene import scene_file
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import theta_of
from climbplan.bookshelf.statement.statement import bookshelf
from climbplan.errors import UsageError
from climbplan.learning.clusters import select_solution_columns
from climbplan.learning.fit_run import TrainingData
from climbplan.progress import Progress
from climbplan.schema.learning.strategy_loading import LoadedStrategy
from climbplan.store.plan_format import plan_format


def shelf_data(loaded: LoadedStrategy, report: Progress | None = None) -> TrainingData:
    """The solved scenes that a spec names, all on one shelf in one meaning.

    Raises:
        PlanFileError: a file that is missing, damaged, or none of scenes.
        UsageError: files that do not go together, or no placement in them.
    """
    spec = loaded.spec.data
    scenes: list[Priced] = []
    first: tuple[Shelf, Meaning, int] | None = None
    for path in loaded.files:
        shelf, meaning, found = _solved(path, report)
        if not found:
            raise UsageError(f"{path}: no scene in it has a placement")
        count = found[0].solved.scene.count
        if first is None:
            first = (shelf, meaning, count)
        require_context(context_of(*first, spec.features), shelf, meaning, count, loaded.files[0])
        scenes += found
    if first is None:
        raise UsageError("no file of solved scenes")
    shelf, meaning, count = first
    scenes = scenes[: spec.size]
    program = bookshelf(count, shelf, meaning)
    # A mirrored scene stands on a mirrored shelf.
    mirror = spec.mirror and abs(shelf.left + shelf.right) < 1e-9
    rows = library_of(program, scenes, feature_map(spec.features, shelf), mirror)
    return TrainingData(
        library=rows.library,
        group=rows.scene,
        hard=rows.library.objective > TRIVIAL,
        columns=select_solution_columns(program.instantiate(theta_of(scenes[0].solved.scene))),
        context=context_of(shelf, meaning, count, spec.features),
        scale=feature_scale(spec.features, count),
        hard_means=f"scenes that need more than {TRIVIAL:g} mm^2 of movement",
    )


def _solved(path: Path, report: Progress | None) -> tuple[Shelf, Meaning, list[Priced]]:
    if plan_format(path) == scene_file.FORMAT:
        return Shelf(), "contact", _solve(path, report)
    plan = solved_scenes(path)
    meaning: Meaning = "published" if plan.meaning == "published" else "contact"
    return plan.shelf, meaning, placed_scenes(plan)


def _solve(path: Path, report: Progress | None) -> list[Priced]:
    """Scenes without solutions, solved on the standard shelf."""
    scenes, solver = read_scenes(path), ExactSolver(Shelf(), ExactLimits())
    found = []
    for k, scene in enumerate(scenes):
        if report is not None:
            report("solve scenes", k / len(scenes))
        answer = solver.solve(scene)
        if answer.placement is not None:
            found.append(Priced(Solved(scene, answer.placement), answer.objective))
    return found
