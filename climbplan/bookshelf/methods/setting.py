"""The settings of which a method is built."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.schema.model import BookshelfSpec, Meaning, ShelfSolverSpec
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.solvers.convex.sessions import ConvexBackend


@dataclass(frozen=True)
class MethodSetting:
    """The settings of a method, from which each worker of a pool builds its own method."""

    shelf: Shelf
    meaning: Meaning
    solver: ShelfSolverSpec
    directory: Path  # where the spec's files are looked up
    seed: int = 0

    @classmethod
    def of(cls, spec: BookshelfSpec, shelf: Shelf, directory: Path) -> MethodSetting:
        """Return the settings that a spec gives."""
        return cls(shelf, spec.formulation, spec.solver, directory, spec.seed)


def select_convex_solver(name: str | None) -> ConvexBackend:
    """Select a solver of convex programs by name; raises UsageError for an unknown one."""
    if name in (None, "daqp"):
        return "daqp"
    if name == "clarabel":
        return "clarabel"
    if name == "osqp":
        return "osqp"
    raise UsageError(f"unknown convex solver {name!r}: expected daqp, clarabel or osqp")
