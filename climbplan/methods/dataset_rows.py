"""Instances of a stated program as rows of a dataset: sampled, solved, and read back as a library.

integers: the integer variables, then the chosen alternative of each choice. solution: x (N) and
assignment (C).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.learning.library import Frame, Library
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings, SharedCache
from climbplan.program.problem import Problem
from climbplan.store.dataset import Dataset, DatasetFrame, solution_layout
from climbplan.store.dataset_row import RowAnswer
from climbplan.store.program_plan import Layouts

KIND = "program"


class ProgramRows:
    """Draws parameters by the problem's own sampler and solves at them by one method."""

    def __init__(self, problem: Problem, method: Method, settings: MethodSettings) -> None:
        """Raises StatementError for a problem without a sampler."""
        if problem.sample is None:
            problem.sample_parameters(np.random.default_rng(0))  # raises StatementError
        self._problem, self._method, self._settings = problem, method, settings
        self._frame = build_frame(problem)
        self._shared = SharedCache()
        self._integer = Frame.of(problem.program).integer

    @property
    def frame(self) -> DatasetFrame:
        """Parameters and variables of the statement."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> dict[str, Array]:
        """Parameters by block."""
        return self._problem.sample_parameters(rng)

    def parameters(self, drawn: Mapping[str, Array]) -> Array:
        """One after the other."""
        return self._problem.program.theta(drawn)

    def solve(self, drawn: Mapping[str, Array]) -> RowAnswer:
        """The answer that the statement itself has judged."""
        done = solve_instance(self._problem, drawn, self._method, self._settings, self._shared)
        found = done.result
        word = f"{done.winner}" if found.x is not None else next(iter(found.log[-1:]), "")
        if found.x is None or found.assignment is None or found.objective is None:
            status = "limit" if found.status in ("optimal", "feasible") else found.status
            return RowAnswer(status, word, bound=_convert_bound(found.bound), time=done.time)
        binaries = np.round(found.x[self._integer])
        integers = np.concatenate([binaries, found.assignment]).astype(np.int64)
        return RowAnswer(
            status=found.status,
            message=word,
            solution={"x": found.x, "assignment": np.asarray(found.assignment, np.int64)},
            integers=integers,
            objective=found.objective,
            bound=_convert_bound(found.bound),
            time=done.time,
        )


def build_frame(problem: Problem) -> DatasetFrame:
    """What rows of a problem share: the columns of its parameters and variables."""
    layouts = Layouts.of(problem.program)
    integer = Frame.of(problem.program).integer
    names = [
        f"{block.name}{_format_index(k, block.shape)}"
        for block in layouts.variables
        for k in range(block.stop - block.start)
    ]
    choices = int(problem.program.counts()["choices"])
    facts = {
        "parameter_blocks": [_convert_to_json(asdict(block)) for block in layouts.parameters],
        "variable_blocks": [_convert_to_json(asdict(block)) for block in layouts.variables],
        "choices": choices,
    }
    return DatasetFrame(
        kind=KIND,
        problem=problem.name,
        facts=facts,
        parameter_names=tuple(
            f"{block.name}{_format_index(k, block.shape)}"
            for block in layouts.parameters
            for k in range(int(np.prod(block.shape, dtype=int)))
        ),
        integer_names=(
            *(name for name, whole in zip(names, integer, strict=True) if whole),
            *(f"choice_{k}" for k in range(choices)),
        ),
        layouts={
            "x": solution_layout((len(names),)),
            "assignment": solution_layout((choices,), kind="int"),
        },
    )


def mask_integer_variables(problem: Problem) -> BoolArray:
    """Which variables (N,) the column `integers` holds first."""
    return Frame.of(problem.program).integer


def build_library(problem: Problem, data: Dataset) -> Library:
    """The answered rows of a dataset as a library, features computed anew.

    Raises UsageError for another problem's dataset, or one without any answer.
    """
    expected = build_frame(problem)
    if data.frame != expected:
        raise UsageError(
            f"made for problem {data.frame.problem!r}, which has other variables or parameters "
            f"than {problem.name!r}"
        )
    found = np.flatnonzero(data.feasible)
    if not len(found):
        raise UsageError(f"none of its {data.count} rows has an answer")
    features = [problem.feature_vector(problem.split(data.parameters[row])) for row in found]
    return Library.of(
        Frame.of(problem.program),
        np.array(features),
        data.solution["x"][found],
        data.objective[found],
        data.solution["assignment"][found],
    )


def _format_index(k: int, shape: tuple[int, ...]) -> str:
    """Where entry k of a block stands: "[2, 0]"; nothing of a single number."""
    if not shape:
        return ""
    return f"[{', '.join(str(int(i)) for i in np.unravel_index(k, shape))}]"


def _convert_to_json(block: dict[str, object]) -> dict[str, object]:
    """With lists where JSON has no tuples."""
    return {key: list(v) if isinstance(v, tuple) else v for key, v in block.items()}


def _convert_bound(bound: float) -> float:
    return -math.inf if math.isnan(bound) else float(bound)
