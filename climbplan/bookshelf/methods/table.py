"""Selection of the method that solves scenes, by name."""

from __future__ import annotations

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.methods.features import count_features
from climbplan.bookshelf.methods.placement_evaluator import PlacementEvaluator
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.shelf_context import require_context
from climbplan.bookshelf.methods.table_method import (
    TableMethod,
    build_model_method,
    select_model_features,
)
from climbplan.errors import UsageError
from climbplan.learning.model_file import read_model


def load_trained_method(
    setting: MethodSetting, count: int, evaluator: PlacementEvaluator
) -> TableMethod:
    """Load the method of a model file, without a fallback.

    Raises:
        UsageError: a model of another method, shelf, meaning or number of books.
        PlanFileError: a damaged file.
    """
    solver = setting.solver
    if solver.model is None:
        raise UsageError(
            f"method {solver.method!r} needs a trained strategy: give a model file of "
            "`climbplan fit-strategy` as solver.model.file"
        )
    path = setting.directory / solver.model.file
    model = read_model(path).model
    if model.kind != solver.method:
        raise UsageError(
            f"{path}: expected a model for method {solver.method!r}, got one of kind {model.kind!r}"
        )
    require_context(model.context, setting.shelf, setting.meaning, count, str(path))
    try:
        model.library.require(
            evaluator.program, count_features(select_model_features(model), count)
        )
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return build_model_method(model, setting, evaluator)


_TRAINED = ("forest", "boosting", "network", "reduce")
_LEARNED = (*_TRAINED, "knn")  # `exact` answers where they have no candidate that holds


def prepare_method(setting: MethodSetting, count: int) -> SceneMethod:
    """Prepare the method for scenes of `count` stored books.

    All but `exact` are those of the common table.

    Raises:
        UsageError: options that exclude each other, or a model or library of another shelf.
        PlanFileError: a damaged library.
        MissingSolver: a solver that is not installed.
    """
    solver = setting.solver
    if solver.method == "exact":
        return _build_exact_solver(setting)
    # These load CasADi and their solvers: not before they are needed.
    from climbplan.bookshelf.methods.library import LibraryTarget, read_library
    from climbplan.bookshelf.methods.table_method import WithFallback, build_method

    evaluator = PlacementEvaluator(count, setting.shelf, setting.meaning)
    if solver.method in _TRAINED or (solver.method == "knn" and solver.model is not None):
        method = load_trained_method(setting, count, evaluator)
    elif solver.method in ("pinned", "knn") or (solver.method == "mpcc" and solver.start == "knn"):
        if solver.library is None:
            raise UsageError(
                f"method {solver.method!r} takes candidates from solved scenes: give a plan file "
                "of `climbplan solve-bookshelf` or a dataset as solver.library.file"
            )
        target = LibraryTarget(setting.shelf, setting.meaning, count)
        library = read_library(evaluator.program, target, solver.library, setting.directory)
        method = build_method(setting, evaluator, library)
    else:
        method = build_method(setting, evaluator)
    if solver.method in _LEARNED and solver.fallback:
        return WithFallback(method, _build_exact_solver(setting), evaluator)
    return method


def _build_exact_solver(setting: MethodSetting) -> ExactSolver:
    solver = setting.solver
    limits = ExactLimits(solver.gap_mm2, solver.gap, solver.time_limit, solver.node_limit)
    return ExactSolver(setting.shelf, limits)
