"""What a worker is told: how to make its sampler and solver, and which rows are wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from climbplan.bookshelf.dataset_rows import ShelfRows
from climbplan.learning.dataset_rows import ProgramRows
from climbplan.learning.program_run import library_of, settings_of
from climbplan.plans.dataset_row import RowSource
from climbplan.program.problem import Problem
from climbplan.spec.dataset import BookshelfProblemSpec, ProgramProblemSpec


@dataclass(frozen=True)
class Recipe:
    """Plain values and functions known by name, so that any process can follow it."""

    source: Callable[[], RowSource[Any]]  # made anew in each worker
    seed: int
    row_seconds: float  # [s] a worker that spends more on one row ends itself
    token: str  # equal ones have equal sources


@dataclass(frozen=True)
class Chunk:
    """Rows that one worker is asked for at once."""

    rows: tuple[int, ...]
    attempt: int = 0
    only_draw: bool = False  # after the solver has killed two workers


def shelf_source(spec: BookshelfProblemSpec, directory: Path, seed: int) -> ShelfRows:
    """Bookshelf scenes as a spec describes them."""
    return ShelfRows(spec, directory, seed)


def program_source(
    load: Callable[[], Problem], spec: ProgramProblemSpec, library: Path | None
) -> ProgramRows:
    """A stated problem; `load` imports it. `library`: solved rows for methods that need them."""
    problem = load()
    solved = None if library is None else library_of(problem, library)
    return ProgramRows(problem, spec.solver.method, settings_of(spec.solver, solved))
