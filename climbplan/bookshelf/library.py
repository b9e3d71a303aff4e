"""Solved scenes as a library of the statement, from plan files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.bookshelf.mirror import Solved, mirrored
from climbplan.bookshelf.plan_file import read_shelf_plan
from climbplan.bookshelf.points import features_of, point_of, theta_of
from climbplan.errors import UsageError
from climbplan.learning.library import Frame, Library
from climbplan.program import Program
from climbplan.spec.bookshelf import ShelfLibrarySpec


def read_library(
    program: Program, count: int, source: ShelfLibrarySpec, directory: Path
) -> Library:
    """The placements of a plan file, as points of a program with `count` stored books.

    Each scene counts twice, the second time as seen in a mirror: twice the data for nothing.
    The slot of the inserted book is a label: the statement leaves it to the lines.

    Raises:
        PlanFileError: no such file, damaged, or no plan of a bookshelf.
        UsageError: another number of stored books, or no placement in it.
    """
    path = directory / source.file
    plan = read_shelf_plan(path)
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
