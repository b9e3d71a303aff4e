"""What a worker is told: how to make its sampler and solver, and which rows are wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from climbplan.store.dataset_row import RowSource


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
