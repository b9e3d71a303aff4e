"""Solved problems of one's own and what was trained on them, from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.clusters import solution_columns
from climbplan.learning.fit_run import TrainingData
from climbplan.learning.library import Frame, Library
from climbplan.learning.model import StrategyModel
from climbplan.learning.model_file import read_model
from climbplan.methods.dataset_rows import library_of_dataset
from climbplan.program.problem import Problem
from climbplan.schema.learning.strategy_loading import LoadedStrategy
from climbplan.store import dataset_file
from climbplan.store.plan_format import plan_format
from climbplan.store.program_file import read_program
from climbplan.store.program_plan import Layouts


def library_of(problem: Problem, path: Path) -> Library:
    """The answered rows of an earlier plan or dataset of the same problem.

    Raises PlanFileError for another file, UsageError for another problem's or an empty one.
    """
    if plan_format(path) == dataset_file.FORMAT:
        try:
            return library_of_dataset(problem, dataset_file.read_dataset_file(path))
        except PlanFileError:
            raise
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from error
    plan = read_program(path)
    if not plan.layouts.same_columns(Layouts.of(problem.program)):
        raise UsageError(
            f"{path}: made for problem {plan.problem!r}, which has other variables or parameters "
            f"than {problem.name!r}"
        )
    found = np.flatnonzero(plan.found)
    if not len(found):
        raise UsageError(f"{path}: none of its {plan.count} rows has an answer")
    # The features are computed anew, so that a statement may change them after the run.
    features = [problem.feature_vector(problem.split(plan.parameters[row])) for row in found]
    frame = Frame.of(problem.program)
    return Library.of(
        frame, np.array(features), plan.x[found], plan.objective[found], plan.assignment[found]
    )


def model_of(problem: Problem, path: Path) -> StrategyModel:
    """A trained strategy of the same problem.

    Raises PlanFileError for another file, UsageError for another problem's model.
    """
    model = read_model(path).model
    if model.context.get("problem") != problem.name:
        raise UsageError(
            f"{path}: made for problem {model.context.get('problem')!r}, not for {problem.name!r}"
        )
    return model


def program_data(problem: Problem, loaded: LoadedStrategy) -> TrainingData:
    """Solved problems of one's own, from plan files of `climbplan solve` and datasets.

    Raises as `program_run.library_of`.
    """
    parts = [library_of(problem, path) for path in loaded.files]
    first = parts[0]
    whole = Library.of(
        first.frame,
        *(np.concatenate([vars(p)[name] for p in parts]) for name in _ROWS),
    )
    size = loaded.spec.data.size
    if size is not None:
        whole = whole.subset(np.arange(min(size, whole.size)))
    rows = np.arange(whole.size)
    theta = problem.split(np.zeros(sum(_sizes(problem))))
    instance = problem.program.at(theta)
    return TrainingData(
        library=whole,
        group=rows,
        hard=np.zeros(whole.size, bool),
        columns=solution_columns(instance),
        context={"problem": problem.name, "features": whole.features.shape[1]},
    )


_ROWS = ("features", "points", "objective", "alternatives")


def _sizes(problem: Problem) -> list[int]:
    return [int(np.prod(shape, dtype=int)) for shape in problem.program.parameters.values()]
