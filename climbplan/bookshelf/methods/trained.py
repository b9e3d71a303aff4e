"""A trained model of a file as a method on scenes."""

from __future__ import annotations

from climbplan.bookshelf.methods.by_table import ByTable, model_features, model_method
from climbplan.bookshelf.methods.features import feature_count
from climbplan.bookshelf.methods.judge import Judge
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
