"""The methods that solve scenes, by name."""

from __future__ import annotations

from climbplan.bookshelf.exact.method import ExactLimits, ExactSolver
from climbplan.bookshelf.methods.by_table import ByTable, model_features, model_method
from climbplan.bookshelf.methods.features import feature_count
from climbplan.bookshelf.methods.judge import Judge
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.shelf_context import require_context
from climbplan.errors import UsageError
from climbplan.learning.model_file import read_model


def trained_method(setting: MethodSetting, count: int, judge: Judge) -> ByTable:
    """The method of a model file, without a fallback.

    Raises UsageError for a model of another method, shelf, meaning or number of books,
    PlanFileError for a damaged file.
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
        raise UsageError(f"{path}: a model of kind {model.kind!r}, method is {solver.method!r}")
    require_context(model.context, setting.shelf, setting.meaning, count, str(path))
    try:
        model.library.require(judge.program, feature_count(model_features(model), count))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return model_method(model, setting, judge)


_TRAINED = ("forest", "boosting", "network", "reduce")
_LEARNED = (*_TRAINED, "knn")  # `exact` answers where they have no candidate that holds


def prepare(setting: MethodSetting, count: int) -> SceneMethod:
    """A method made ready for scenes of `count` stored books.

    All but `exact` are those of the common table. Raises UsageError for what does not go together,
    PlanFileError for a damaged library, MissingSolver for a solver that is not installed.
    """
    solver = setting.solver
    if solver.method == "exact":
        return _exact(setting)
    # These load CasADi and their solvers: not before they are needed.
    from climbplan.bookshelf.methods.by_table import WithFallback, whole_method
    from climbplan.bookshelf.methods.library import Wanted, read_library

    judge = Judge(count, setting.shelf, setting.meaning)
    if solver.method in _TRAINED or (solver.method == "knn" and solver.model is not None):
        method = trained_method(setting, count, judge)
    elif solver.method in ("convex", "knn") or (solver.method == "mpcc" and solver.start == "knn"):
        if solver.library is None:
            raise UsageError(
                f"method {solver.method!r} takes candidates from solved scenes: give a plan file "
                "of `climbplan solve-bookshelf` or a dataset as solver.library.file"
            )
        wanted = Wanted(setting.shelf, setting.meaning, count)
        library = read_library(judge.program, wanted, solver.library, setting.directory)
        method = whole_method(setting, judge, library)
    else:
        method = whole_method(setting, judge)
    if solver.method in _LEARNED and solver.fallback:
        return WithFallback(method, _exact(setting), judge)
    return method


def _exact(setting: MethodSetting) -> ExactSolver:
    solver = setting.solver
    limits = ExactLimits(solver.gap_mm2, solver.gap, solver.time_limit, solver.node_limit)
    return ExactSolver(setting.shelf, limits)
