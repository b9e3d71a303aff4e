"""The methods that solve scenes, by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from climbplan.bookshelf.answer import SceneAnswer
from climbplan.bookshelf.exact import ExactLimits, ExactSolver
from climbplan.bookshelf.scene import Scene, Shelf
from climbplan.errors import UsageError
from climbplan.spec.bookshelf import BookshelfSpec, Meaning, ShelfSolverSpec


class SceneMethod(Protocol):
    """A method that was prepared for one shelf; keeps its space between scenes."""

    def solve(self, scene: Scene) -> SceneAnswer:
        """The best placement that the method finds, judged by the exact check of the meaning."""


@dataclass(frozen=True)
class MethodSetting:
    """All that a method is made of; workers of a pool make their own from it."""

    shelf: Shelf
    meaning: Meaning
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
    # These load CasADi and their solvers: not before they are needed.
    from climbplan.bookshelf import statement_methods as by_statement

    judge = by_statement.Judge(count, setting.shelf, setting.meaning)
    budget = by_statement.Budget(solver.gap, solver.time_limit)
    if solver.method == "minlp-scip":
        return by_statement.MinlpScip(judge, budget)
    if solver.method == "minlp-bonmin":
        return by_statement.MinlpBonmin(judge, budget)
    if solver.method == "micp":
        return by_statement.Micp(judge, budget, solver.solver or "highs")
    if solver.method == "admm":
        return by_statement.Admm(judge, budget, solver.solver or "highs")
    if solver.method == "mpcc" and solver.start == "zero":
        return by_statement.Mpcc(judge, budget, by_statement.zero_start)
    if solver.method == "mpcc" and solver.start == "manual":
        return by_statement.Mpcc(judge, budget, by_statement.manual_start)
    raise UsageError(f"method {solver.method!r} is not there yet")
