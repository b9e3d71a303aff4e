"""The methods that solve scenes, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting, convex_solver
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.bookshelf.methods.statement import Budget, Judge


_TRAINED = ("forest", "boosting", "network", "reduce")


def prepare(setting: MethodSetting, count: int) -> SceneMethod:
    """A method made ready for scenes of `count` stored books.

    Raises UsageError for what does not go together, PlanFileError for a damaged library,
    MissingSolver for a solver that is not installed.
    """
    solver = setting.solver
    if solver.method == "exact":
        return _exact(setting)
    # These load CasADi and their solvers: not before they are needed.
    from climbplan.bookshelf.methods import statement as by_statement

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
    return _learned(setting, count, judge, budget)


def _learned(setting: MethodSetting, count: int, judge: Judge, budget: Budget) -> SceneMethod:
    from climbplan.bookshelf.methods.learned import Convex, WithFallback, neighbours_start
    from climbplan.bookshelf.methods.library import Wanted, read_library
    from climbplan.bookshelf.methods.statement import Mpcc
    from climbplan.learning.neighbours import NearestProblems

    solver = setting.solver
    if solver.method in _TRAINED or (solver.method == "knn" and solver.model is not None):
        from climbplan.bookshelf.methods.trained import trained_method

        trained = trained_method(setting, count, judge)
        return WithFallback(trained, _exact(setting), judge) if solver.fallback else trained
    if solver.library is None:
        raise UsageError(
            f"method {solver.method!r} takes candidates from solved scenes: give a plan file of "
            "`climbplan solve-bookshelf` or a dataset as solver.library.file"
        )
    wanted = Wanted(setting.shelf, setting.meaning, count)
    library = read_library(judge.program, wanted, solver.library, setting.directory)
    if solver.method == "mpcc":
        near = NearestProblems.of(library, "strategies")
        return Mpcc(judge, budget, neighbours_start(near, solver.candidates or 3))
    convex = Convex(
        judge=judge,
        strategy=NearestProblems.of(library, "mixed"),
        candidates=solver.candidates or 50,
        refinements=solver.refinements,
        backend=convex_solver(solver.solver),
        seconds=solver.time_limit,
        gap_mm2=solver.gap_mm2,
    )
    if solver.method == "convex" or not solver.fallback:
        return convex
    return WithFallback(convex, _exact(setting), judge)


def _exact(setting: MethodSetting) -> ExactSolver:
    solver = setting.solver
    limits = ExactLimits(solver.gap_mm2, solver.gap, solver.time_limit, solver.node_limit)
    return ExactSolver(setting.shelf, limits)
