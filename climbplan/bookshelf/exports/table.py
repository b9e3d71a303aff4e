"""Placements as CSV, one line for each book of each scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from climbplan.bookshelf.plan.file import read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.bookshelf.scene.shelf_scene import state_label
from climbplan.store.csv_file import write_csv

HEADER = (
    "scene", "status", "objective_mm2", "book", "height_m", "width_m", "before_x_m", "before_y_m",
    "before_angle_rad", "x_m", "y_m", "angle_rad", "state",
)  # fmt: skip


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write the placements of a plan file as CSV with one header line that names the units.

    Stored books are numbered from the left, the inserted one is `inserted` and has no place before;
    books of scenes without a placement have none after. Numbers keep their full precision. A file
    at `out` is replaced whole or not at all; a stream is written to. Raises PlanFileError for a
    file that is not a bookshelf plan and UsageError if `out` cannot be written.
    """
    plan = read_shelf_plan(path)
    write_csv(out, HEADER, _list_rows(plan))


def _list_rows(plan: ShelfPlan) -> Iterator[list[str | float | int]]:
    scenes, solutions = plan.scenes, plan.solutions
    for k in range(len(scenes)):
        objective = float(solutions.objective[k])
        cost: float | str = objective if math.isfinite(objective) else ""
        for book in range(scenes.count + 1):
            stored = book < scenes.count
            before = scenes.pose[k, book].tolist() if stored else [""] * 3
            placed = solutions.state[k, book] >= 0
            after = solutions.pose[k, book].tolist() if placed else [""] * 3
            state = state_label(int(solutions.state[k, book])) if placed else ""
            name = str(book) if stored else "inserted"
            size = scenes.sizes[k, book].tolist()
            yield [k, solutions.status[k], cost, name, *size, *before, *after, state]
