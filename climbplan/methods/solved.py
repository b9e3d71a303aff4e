"""Read libraries of solved problems and trained models of user problems from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.clusters import select_solution_columns
from climbplan.learning.fit_run import TrainingData
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import StrategyModel
from climbplan.learning.model_file import read_model
from climbplan.methods.dataset_rows import build_library
from climbplan.program.problem import Problem
from climbplan.schema.learning.strategy_loading import LoadedStrategy
from climbplan.store import dataset_file
from climbplan.store.plan_format import read_plan_format
from climbplan.store.program_file import read_program
from climbplan.store.program_plan import Layouts


def read_library(problem: Problem, path: Path) -> Library:
    """Read the answered rows of a plan or dataset of the same problem.

    Raises:
        PlanFileError: The file is of another kind.
        UsageError: It belongs to another problem, or has no answered row.
    """
    if read_plan_format(path) == dataset_file.FORMAT:
        try:
            return build_library(problem, dataset_file.read_dataset_file(path))
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
    answered = np.flatnonzero(plan.found)
    if not len(answered):
        raise UsageError(f"{path}: none of its {plan.count} rows has an answer")
    # Features are recomputed, so that a statement may change them after the run.
    features = [problem.feature_vector(problem.split(plan.parameters[row])) for row in answered]
    frame = ProgramSignature.of(problem.program)
    return Library.of(
        frame,
        np.array(features),
        plan.x[answered],
        plan.objective[answered],
        plan.assignment[answered],
    )


def read_strategy_model(problem: Problem, path: Path) -> StrategyModel:
    """Read a trained strategy of the same problem.

    Raises:
        PlanFileError: The file is of another kind.
        UsageError: It belongs to another problem.
    """
    model = read_model(path).model
    if model.context.get("problem") != problem.name:
        raise UsageError(
            f"{path}: made for problem {model.context.get('problem')!r}, not for {problem.name!r}"
        )
    return model


def read_training_data(problem: Problem, loaded: LoadedStrategy) -> TrainingData:
    """Read solved problems from plan files of `climbplan solve` and datasets.

    Raises:
        PlanFileError: A file is of another kind.
        UsageError: A file belongs to another problem, or has no answered row.
    """
    libraries = [read_library(problem, path) for path in loaded.files]
    first = libraries[0]
    merged = Library.of(
        first.frame,
        *(np.concatenate([vars(p)[name] for p in libraries]) for name in _ROWS),
    )
    size = loaded.spec.data.size
    if size is not None:
        merged = merged.subset(np.arange(min(size, merged.size)))
    rows = np.arange(merged.size)
    theta = problem.split(np.zeros(sum(_list_parameter_sizes(problem))))
    instance = problem.program.instantiate(theta)
    return TrainingData(
        library=merged,
        group=rows,
        hard=np.zeros(merged.size, bool),
        columns=select_solution_columns(instance),
        context={"problem": problem.name, "features": merged.features.shape[1]},
    )


_ROWS = ("features", "points", "objective", "alternatives")


def _list_parameter_sizes(problem: Problem) -> list[int]:
    """Return the size of each parameter block."""
    return [int(np.prod(shape, dtype=int)) for shape in problem.program.parameters.values()]
