"""Solved scenes as a library of the statement, from plan files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import IntArray
from climbplan.bookshelf.methods.features import Features
from climbplan.bookshelf.methods.mirror import Solved, mirrored
from climbplan.bookshelf.methods.shelf_context import context_of, require_context
from climbplan.bookshelf.plan.dataset_frame import shelf_dataset
from climbplan.bookshelf.plan.file import read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.scene.shelf_scene import Shelf, State
from climbplan.bookshelf.schema.model import Meaning, ShelfLibrarySpec
from climbplan.bookshelf.statement.points import features_of, point_of, theta_of
from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.library import Frame, Library
from climbplan.program import Program
from climbplan.store import dataset_file
from climbplan.store.plan_format import plan_format


@dataclass(frozen=True)
class Wanted:
    """What a library is to serve."""

    shelf: Shelf
    meaning: Meaning
    count: int  # of stored books


def read_library(
    program: Program, wanted: Wanted, source: ShelfLibrarySpec, directory: Path
) -> Library:
    """The placements of a plan file or dataset, as points of the program of what is wanted.

    Each scene counts twice, the second time as seen in a mirror: twice the data for nothing.
    The slot of the inserted book is a label: the statement leaves it to the lines.

    Raises:
        PlanFileError: no such file, damaged, or no plan or dataset of a bookshelf.
        UsageError: another number of stored books, another shelf or meaning that the spec does not
            let pass, or no placement in it.
    """
    path = directory / source.file
    plan = solved_scenes(path)
    if plan.scenes.count != wanted.count:
        raise UsageError(
            f"library {path}: its scenes have {plan.scenes.count} stored books, expected "
            f"{wanted.count}"
        )
    if not source.foreign:
        _require_own(plan, wanted, path)
    solved = placed_scenes(plan)[: source.size]
    if not solved:
        raise UsageError(f"library {path}: no scene in it has a placement")
    return library_of(program, solved, features_of, middle=mirror_middle(plan)).library


def _require_own(plan: ShelfPlan, wanted: Wanted, path: Path) -> None:
    """Raises UsageError if a plan's scenes stand on another shelf or have another meaning."""
    theirs = context_of(plan.shelf, plan.meaning, plan.scenes.count, "raw")
    try:
        require_context(theirs, wanted.shelf, wanted.meaning, wanted.count, f"library {path}")
    except UsageError as error:
        raise UsageError(f"{error}; solver.library.foreign: true takes it all the same") from error


@dataclass(frozen=True)
class Priced:
    """A scene with a placement and its cost."""

    solved: Solved
    cost: float  # [mm^2]


@dataclass(frozen=True)
class SceneLibrary:
    """A library, and the scene that each of its rows is of (mirror images share one)."""

    library: Library
    scene: IntArray  # (S,)


def mirror_middle(plan: ShelfPlan) -> float:
    """Where a plan's shelf is its own mirror image [m]; the published frame lies about x = 0
    wherever the walls are."""
    return (plan.shelf.left + plan.shelf.right) / 2 if plan.meaning == "contact" else 0.0


def placed_scenes(plan: ShelfPlan) -> list[Priced]:
    """The scenes of a plan that have a placement."""
    found = plan.solutions
    placements = [(k, found.placement(k)) for k in range(len(plan.scenes))]
    return [
        Priced(Solved(plan.scenes[k], placement), float(found.objective[k]))
        for k, placement in placements
        if placement is not None
    ]


def library_of(
    program: Program,
    scenes: Sequence[Priced],
    features: Features,
    mirror: bool = True,
    middle: float = 0.0,
) -> SceneLibrary:
    """Solved scenes as points of a program; raises UsageError as `Library.of` does.

    mirror: each scene counts twice, the second time as seen in a mirror at x = middle [m].
    """
    rows, points, slots, cost, scene = [], [], [], [], []
    for k, priced in enumerate(scenes):
        both = [priced.solved, mirrored(priced.solved, middle)] if mirror else [priced.solved]
        for solved in both:
            rows.append(features(theta_of(solved.scene)))
            points.append(point_of(program, solved.scene, solved.placement))
            slots.append(solved.placement.slot)
            cost.append(priced.cost)
            scene.append(k)
    library = Library.of(
        Frame.of(program),
        np.array(rows),
        np.array(points),
        np.array(cost),
        labels=np.array(slots, np.int64)[:, None],
    )
    return SceneLibrary(library, np.array(scene, np.int64))


def solved_scenes(path: Path) -> ShelfPlan:
    """Scenes and placements of a file, whichever format it has.

    Raises PlanFileError for a file that is missing, damaged or none of solved scenes, and for a
    state or slot that there is not.
    """
    plan = _plan_of(path)
    found, n = plan.solutions, plan.scenes.count
    wrong = ((found.state < 0) | (found.state >= len(State))).any(axis=1)
    wrong = (wrong | (found.slot < 0) | (found.slot > n)) & found.placed
    if wrong.any():
        k = int(np.argmax(wrong))
        raise PlanFileError(
            f"{path}: scene {k}: states {found.state[k].tolist()} and slot {found.slot[k]} of its "
            f"placement, expected 0 to {len(State) - 1} and 0 to {n}"
        )
    return plan


def _plan_of(path: Path) -> ShelfPlan:
    if plan_format(path) != dataset_file.FORMAT:
        return read_shelf_plan(path)
    try:
        return shelf_dataset(dataset_file.read_dataset_file(path)).plan
    except UsageError as error:
        told = str(error)
        raise PlanFileError(told if told.startswith(str(path)) else f"{path}: {told}") from error
