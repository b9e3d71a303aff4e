"""Solved scenes for a strategy: from datasets and plans, and from scene files solved first."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from climbplan.bookshelf import scene_file
from climbplan.bookshelf.exact import ExactLimits, ExactSolver
from climbplan.bookshelf.features import feature_map, feature_scale
from climbplan.bookshelf.library import Priced, library_of, placed_scenes, solved_scenes
from climbplan.bookshelf.mirror import Solved
from climbplan.bookshelf.points import theta_of
from climbplan.bookshelf.scene import Shelf
from climbplan.bookshelf.scene_file import read_scenes
from climbplan.bookshelf.statement import bookshelf
from climbplan.bookshelf.summary import TRIVIAL
from climbplan.errors import UsageError
from climbplan.learning.clusters import solution_columns
from climbplan.learning.fit_run import TrainingData
from climbplan.plans.plan_format import plan_format
from climbplan.spec.bookshelf import Meaning
from climbplan.spec.strategy_loading import LoadedStrategy

Report = Callable[[str, float], None]
_SAME = 1e-9  # [m, rad] shelves that differ by less are the same


def context_of(shelf: Shelf, meaning: str, count: int, features: str) -> dict[str, Any]:
    """What a model of bookshelf scenes serves: shelf, meaning, number of stored books, features."""
    return {
        "problem": "bookshelf",
        "books": count,
        "meaning": meaning,
        "shelf": asdict(shelf),
        "features": features,
    }


def require_context(
    given: Mapping[str, Any], shelf: Shelf, meaning: str, count: int, where: object
) -> None:
    """Raises UsageError naming the first thing in which a model's context differs."""
    wanted = context_of(shelf, meaning, count, str(given.get("features")))
    if given.get("problem") != "bookshelf":
        raise UsageError(f"{where}: made for problem {given.get('problem')!r}, not for bookshelves")
    if given.get("features") not in ("gaps", "raw"):
        raise UsageError(f"{where}: features {given.get('features')!r} that there are not")
    for key in ("books", "meaning"):
        if given.get(key) != wanted[key]:
            raise UsageError(
                f"{where}: made for {key} {given.get(key)!r}, here it is {wanted[key]!r}"
            )
    theirs, ours = _flat(given.get("shelf")), _flat(wanted["shelf"])
    for key, expected in ours.items():
        found = theirs.get(key)
        if not isinstance(found, float | int) or not math.isclose(found, expected, abs_tol=_SAME):
            raise UsageError(
                f"{where}: made for a shelf whose {key} is {found}, here it is {expected:g}"
            )


def _flat(shelf: object) -> dict[str, Any]:
    """A shelf's numbers, those of the published meaning among them."""
    if not isinstance(shelf, Mapping):
        return {}
    inner = shelf.get("published")
    published = inner if isinstance(inner, Mapping) else {}
    own = {str(key): value for key, value in shelf.items() if key != "published"}
    return own | {f"published {key}": value for key, value in published.items()}


def shelf_data(loaded: LoadedStrategy, report: Report | None = None) -> TrainingData:
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
        columns=solution_columns(program.at(theta_of(scenes[0].solved.scene))),
        context=context_of(shelf, meaning, count, spec.features),
        scale=feature_scale(spec.features, count),
        hard_means=f"scenes that need more than {TRIVIAL:g} mm^2 of movement",
    )


def _solved(path: Path, report: Report | None) -> tuple[Shelf, Meaning, list[Priced]]:
    if plan_format(path) == scene_file.FORMAT:
        return Shelf(), "contact", _solve(path, report)
    plan = solved_scenes(path)
    meaning: Meaning = "published" if plan.meaning == "published" else "contact"
    return plan.shelf, meaning, placed_scenes(plan)


def _solve(path: Path, report: Report | None) -> list[Priced]:
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
