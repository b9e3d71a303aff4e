"""Who makes the rows: what engines have in common."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from climbplan.datasets.recipe import Chunk
from climbplan.store.dataset_row import Row


@dataclass(frozen=True)
class Done:
    """A chunk that came to an end: with its rows, or with the loss of its worker."""

    chunk: Chunk
    rows: tuple[Row, ...] = ()
    lost: str = ""  # how its worker was lost, "" if it was not


class Engine(Protocol):
    """Workers, each busy with one chunk at a time, so that a loss is the loss of that chunk."""

    def __enter__(self) -> Self:
        """Start."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all workers at once."""

    @property
    def width(self) -> int:
        """Return how many chunks can be worked on at once, at the moment."""

    def idle(self) -> bool:
        """Return whether there is a worker for one more chunk."""

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk to an idle worker."""

    def wait(self, seconds: float) -> list[Done]:
        """Return what came to an end meanwhile. Raises what making a source raises."""
