"""Solved scenes as a library of the statement, from plan files.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import IntArray
from climbplan.bookshelf.methods.features import Features
from climbplan.bookshelf.methods.mirror import SolvedScene, mirror_scene
from climbplan.bookshelf.methods.shelf_context import build_context, require_context
from climbplan.bookshelf.plan.dataset_frame import read_shelf_dataset
from climbplan.bookshelf.plan.file import read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.scene.shelf_scene import BookState, Shelf
from climbplan.bookshelf.schema.model import Meaning, ShelfLibrarySpec
from climbplan.bookshelf.statement.points import build_point, build_theta, compute_features
from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.library import Library, ProgramSignature
from climbplan.program import Program
from climbplan.store import dataset_file
from climbplan.store.plan_format import read_plan_format


@dataclass(frozen=True)
class LibraryTarget:
    """The shelf, meaning and number of books that a library must serve."""

    shelf: Shelf
    meaning: Meaning
    count: int  # of stored books


def read_library(
    program: Program, target: LibraryTarget, source: ShelfLibrarySpec, directory: Path
) -> Library:
    """Read the placements of a plan file or dataset as points of the target's program.

    Each scene counts twice, the second time as seen in a mirror: twice the data for nothing.
    The slot of the inserted book is a label: the statement leaves it to the lines.

    Raises:
        PlanFileError: no such file, damaged, or no plan or dataset of a bookshelf.
        UsageError: another number of stored books, another shelf or meaning that the spec does not
            let pass, or no placement in it.
    """
    path = directory / source.file
    plan = read_solved_scenes(path)
    if plan.scenes.count != target.count:
        raise UsageError(
            f"library {path}: its scenes have {plan.scenes.count} stored books, expected "
            f"{target.count}"
        )
    if not source.allow_other_shelves:
        _require_same_shelf(plan, target, path)
    solved = collect_placed_scenes(plan)[: source.size]
    if not solved:
        raise UsageError(f"library {path}: no scene in it has a placement")
    return build_library(program, solved, compute_features, middle=find_mirror_axis(plan)).library


def _require_same_shelf(plan: ShelfPlan, target: LibraryTarget, path: Path) -> None:
    """Raise UsageError if a plan's scenes stand on another shelf or have another meaning."""
    context = build_context(plan.shelf, plan.meaning, plan.scenes.count, "raw")
    try:
        require_context(context, target.shelf, target.meaning, target.count, f"library {path}")
    except UsageError as error:
        raise UsageError(
            f"{error}; solver.library.allow_other_shelves: true takes it all the same"
        ) from error


@dataclass(frozen=True)
class Priced:
    """A scene with a placement and its cost."""

    solved: SolvedScene
    cost: float  # [mm^2]


@dataclass(frozen=True)
class SceneLibrary:
    """A library, and the scene that each of its rows is of (mirror images share one)."""

    library: Library
    scene: IntArray  # (S,)


def find_mirror_axis(plan: ShelfPlan) -> float:
    """Return the x coordinate of the mirror axis of a plan's shelf [m].

    The published frame lies about x = 0 wherever the walls are.
    """
    return (plan.shelf.left + plan.shelf.right) / 2 if plan.meaning == "contact" else 0.0


def collect_placed_scenes(plan: ShelfPlan) -> list[Priced]:
    """Collect the scenes of a plan that have a placement."""
    solutions = plan.solutions
    placements = [(k, solutions.placement(k)) for k in range(len(plan.scenes))]
    return [
        Priced(SolvedScene(plan.scenes[k], placement), float(solutions.objective[k]))
        for k, placement in placements
        if placement is not None
    ]


def build_library(
    program: Program,
    scenes: Sequence[Priced],
    features: Features,
    mirror: bool = True,
    middle: float = 0.0,
) -> SceneLibrary:
    """Build a library of solved scenes as points of a program.

    Args:
        program: the bookshelf program of their number of books.
        scenes: placements with their costs.
        features: the map from parameters to features.
        mirror: whether each scene counts twice, the second time as its mirror image.
        middle: x coordinate of the mirror axis [m].

    Raises:
        UsageError: no scene, or points that do not fit the program.
    """
    rows, points, slots, cost, scene = [], [], [], [], []
    for k, priced in enumerate(scenes):
        both = [priced.solved, mirror_scene(priced.solved, middle)] if mirror else [priced.solved]
        for solved in both:
            rows.append(features(build_theta(solved.scene)))
            points.append(build_point(program, solved.scene, solved.placement))
            slots.append(solved.placement.slot)
            cost.append(priced.cost)
            scene.append(k)
    library = Library.of(
        ProgramSignature.of(program),
        np.array(rows),
        np.array(points),
        np.array(cost),
        labels=np.array(slots, np.int64)[:, None],
    )
    return SceneLibrary(library, np.array(scene, np.int64))


def read_solved_scenes(path: Path) -> ShelfPlan:
    """Read scenes and placements of a plan file or dataset.

    Raises:
        PlanFileError: the file is missing, damaged or none of solved scenes, or has an unknown
            state or slot.
    """
    plan = _read_plan(path)
    solutions, n = plan.solutions, plan.scenes.count
    is_wrong = ((solutions.state < 0) | (solutions.state >= len(BookState))).any(axis=1)
    is_wrong = (is_wrong | (solutions.slot < 0) | (solutions.slot > n)) & solutions.placed
    if is_wrong.any():
        k = int(np.argmax(is_wrong))
        raise PlanFileError(
            f"{path}: scene {k}: states {solutions.state[k].tolist()} and slot {solutions.slot[k]} "
            f"of its placement, expected 0 to {len(BookState) - 1} and 0 to {n}"
        )
    return plan


def _read_plan(path: Path) -> ShelfPlan:
    if read_plan_format(path) != dataset_file.FORMAT:
        return read_shelf_plan(path)
    try:
        return read_shelf_dataset(dataset_file.read_dataset_file(path)).plan
    except UsageError as error:
        message = str(error)
        raise PlanFileError(
            message if message.startswith(str(path)) else f"{path}: {message}"
        ) from error
