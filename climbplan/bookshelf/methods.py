"""The methods that solve scenes, by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from climbplan.bookshelf.answer import SceneAnswer
from climbplan.bookshelf.exact import ExactLimits, ExactSolver
from climbplan.bookshelf.scene import Scene, Shelf
from climbplan.errors import UsageError
from climbplan.spec.bookshelf import BookshelfSpec, ShelfSolverSpec


class SceneMethod(Protocol):
    """A method that was prepared for one shelf; keeps its space between scenes."""

    def solve(self, scene: Scene) -> SceneAnswer:
        """The best placement that the method finds, judged by the exact check of the meaning."""


@dataclass(frozen=True)
class MethodSetting:
    """All that a method is made of; workers of a pool make their own from it."""

    shelf: Shelf
    meaning: str
    solver: ShelfSolverSpec
    directory: Path  # where the spec's files are looked up
    seed: int = 0

    @classmethod
    def of(cls, spec: BookshelfSpec, shelf: Shelf, directory: Path) -> MethodSetting:
        """As written in a spec."""
        return cls(shelf, spec.meaning, spec.solver, directory, spec.seed)


def prepare(setting: MethodSetting, count: int) -> SceneMethod:
    """A method made ready for scenes of `count` stored books.

    Raises UsageError for what does not go together, PlanFileError for a damaged library,
    MissingSolver for a solver that is not installed.
    """
    solver = setting.solver
    if solver.method == "exact":
        limits = ExactLimits(solver.gap_mm2, solver.gap, solver.time_limit, solver.node_limit)
        return ExactSolver(setting.shelf, limits)
    raise UsageError(f"method {solver.method!r} is not there yet")
