"""Rows of a dataset from a stated program: sampled, solved, and read back as a library.

The column `integers` has the integer variables, then the chosen alternative of each choice. The
column `solution` has x (N) and assignment (C).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError
from climbplan.learning.library import Library, ProgramSignature
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings, SharedCache
from climbplan.program.problem import Problem
from climbplan.store.dataset import Dataset, DatasetFrame, build_solution_layout
from climbplan.store.dataset_row import RowAnswer
from climbplan.store.program_plan import Layouts

KIND = "program"


class ProgramRows:
    """Samples parameters with the problem's own sampler and solves them by one method."""

    def __init__(self, problem: Problem, method: Method, settings: MethodSettings) -> None:
        """Prepare the columns.

        Raises:
            StatementError: The problem has no sampler.
        """
        if problem.sample is None:
            problem.sample_parameters(np.random.default_rng(0))  # raises StatementError
        self._problem, self._method, self._settings = problem, method, settings
        self._frame = build_frame(problem)
        self._shared = SharedCache()
        self._integer = ProgramSignature.of(problem.program).integer

    @property
    def frame(self) -> DatasetFrame:
        """Columns of parameters and variables."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> dict[str, Array]:
        """Sample parameters by block."""
        return self._problem.sample_parameters(rng)

    def parameters(self, theta: Mapping[str, Array]) -> Array:
        """Concatenate parameters."""
        return self._problem.program.theta(theta)

    def solve(self, theta: Mapping[str, Array]) -> RowAnswer:
        """Solve at sampled parameters; the statement itself has judged the answer."""
        method_result = solve_instance(
            self._problem, theta, self._method, self._settings, self._shared
        )
        result = method_result.result
        message = (
            f"{method_result.winner}" if result.x is not None else next(iter(result.log[-1:]), "")
        )
        if result.x is None or result.assignment is None or result.objective is None:
            status = "limit" if result.status in ("optimal", "feasible") else result.status
            return RowAnswer(
                status, message, bound=_convert_bound(result.bound), time=method_result.time
            )
        binaries = np.round(result.x[self._integer])
        integers = np.concatenate([binaries, result.assignment]).astype(np.int64)
        return RowAnswer(
            status=result.status,
            message=message,
            solution={"x": result.x, "assignment": np.asarray(result.assignment, np.int64)},
            integers=integers,
            objective=result.objective,
            bound=_convert_bound(result.bound),
            time=method_result.time,
        )


def build_frame(problem: Problem) -> DatasetFrame:
    """Build the columns of parameters and variables that rows of a problem share."""
    layouts = Layouts.of(problem.program)
    integer = ProgramSignature.of(problem.program).integer
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
            "x": build_solution_layout((len(names),)),
            "assignment": build_solution_layout((choices,), kind="int"),
        },
    )


def mask_integer_variables(problem: Problem) -> BoolArray:
    """Return the mask (N,) of variables that the column `integers` has first."""
    return ProgramSignature.of(problem.program).integer


def build_library(problem: Problem, data: Dataset) -> Library:
    """Build a library from the answered rows of a dataset, with features computed again.

    Raises:
        UsageError: The dataset belongs to another problem, or has no answer.
    """
    expected = build_frame(problem)
    if data.frame != expected:
        raise UsageError(
            f"made for problem {data.frame.problem!r}, which has other variables or parameters "
            f"than {problem.name!r}"
        )
    answered = np.flatnonzero(data.feasible)
    if not len(answered):
        raise UsageError(f"none of its {data.count} rows has an answer")
    features = [problem.feature_vector(problem.split(data.parameters[row])) for row in answered]
    return Library.of(
        ProgramSignature.of(problem.program),
        np.array(features),
        data.solution["x"][answered],
        data.objective[answered],
        data.solution["assignment"][answered],
    )


def _format_index(k: int, shape: tuple[int, ...]) -> str:
    """Format the index of entry k of a block as "[2, 0]"; empty for a single number."""
    if not shape:
        return ""
    return f"[{', '.join(str(int(i)) for i in np.unravel_index(k, shape))}]"


def _convert_to_json(block: dict[str, object]) -> dict[str, object]:
    """Replace tuples by lists for JSON."""
    return {key: list(v) if isinstance(v, tuple) else v for key, v in block.items()}


def _convert_bound(bound: float) -> float:
    """Return a bound with -infinity instead of NaN."""
    return -math.inf if math.isnan(bound) else float(bound)
