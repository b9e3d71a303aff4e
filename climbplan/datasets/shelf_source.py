"""Rows of bookshelf scenes, as a worker makes them: loads what scenes need and no more."""

from __future__ import annotations

from pathlib import Path

from climbplan.bookshelf.planner.dataset_rows import ShelfRows
from climbplan.bookshelf.schema.dataset import BookshelfProblemSpec


def build_shelf_source(spec: BookshelfProblemSpec, directory: Path, seed: int) -> ShelfRows:
    """Return bookshelf scenes as a spec describes them; files are looked up from `directory`."""
    return ShelfRows(spec, directory, seed)
