"""Solved scenes as a library of the statement, from plan files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.bookshelf.dataset_rows import shelf_dataset
from climbplan.bookshelf.mirror import Solved, mirrored
from climbplan.bookshelf.plan import ShelfPlan
from climbplan.bookshelf.plan_file import read_shelf_plan
from climbplan.bookshelf.points import features_of, point_of, theta_of
from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.library import Frame, Library
from climbplan.plans import dataset_file
from climbplan.plans.plan_format import plan_format
from climbplan.program import Program
from climbplan.spec.bookshelf import ShelfLibrarySpec


def read_library(
    program: Program, count: int, source: ShelfLibrarySpec, directory: Path
) -> Library:
    """The placements of a plan file or dataset, as points of a program with `count` stored books.

    Each scene counts twice, the second time as seen in a mirror: twice the data for nothing.
    The slot of the inserted book is a label: the statement leaves it to the lines.

    Raises:
        PlanFileError: no such file, damaged, or no plan or dataset of a bookshelf.
        UsageError: another number of stored books, or no placement in it.
    """
    path = directory / source.file
    plan = _solved(path)
    if plan.scenes.count != count:
        raise UsageError(
            f"library {path}: its scenes have {plan.scenes.count} stored books, expected {count}"
        )
    # The published frame lies about x = 0 wherever the walls are
    middle = (plan.shelf.left + plan.shelf.right) / 2 if plan.meaning == "contact" else 0.0
    features, points, slots, cost = [], [], [], []
    for k, scene in enumerate(plan.scenes):
        placement = plan.solutions.placement(k)
        if source.size is not None and k >= source.size:
            break
        if placement is not None:
            here = Solved(scene, placement)
            for solved in (here, mirrored(here, middle)):
                features.append(features_of(theta_of(solved.scene)))
                points.append(point_of(program, solved.scene, solved.placement))
                slots.append(solved.placement.slot)
                cost.append(float(plan.solutions.objective[k]))
    if not points:
        raise UsageError(f"library {path}: no scene in it has a placement")
    return Library.of(
        Frame.of(program),
        np.array(features),
        np.array(points),
        np.array(cost),
        labels=np.array(slots, np.int64)[:, None],
    )


def _solved(path: Path) -> ShelfPlan:
    """Scenes and placements of a file, whichever format it has."""
    if plan_format(path) != dataset_file.FORMAT:
        return read_shelf_plan(path)
    try:
        return shelf_dataset(dataset_file.read_dataset_file(path)).plan
    except UsageError as error:
        told = str(error)
        raise PlanFileError(told if told.startswith(str(path)) else f"{path}: {told}") from error
