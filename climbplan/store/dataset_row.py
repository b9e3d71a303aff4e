"""One row of a dataset, and what can make rows: a problem kind with a sampler and a solver."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, IntArray
from climbplan.store.dataset import ANSWERED, Dataset, DatasetFrame
from climbplan.store.hdf5_layout import Kind

Drawn = TypeVar("Drawn")
_EMPTY: dict[Kind, tuple[Any, type[Any]]] = {  # entries of rows without an answer, and their type
    "float": (math.nan, np.float64),
    "int": (-1, np.int64),
    "bool": (False, np.bool_),
    "text": ("", np.object_),
}


@dataclass(frozen=True)
class RowAnswer:
    """What a solver made of one problem, checked."""

    status: str  # of `dataset.STATUSES`
    message: str = ""
    solution: Mapping[str, NDArray[Any]] | None = None  # as the frame's layouts say, without rows
    integers: IntArray | None = None  # (q,)
    objective: float = math.nan
    bound: float = -math.inf
    time: float = 0.0  # [s]
    evidence: Mapping[str, NDArray[Any]] | None = None  # what a row without an answer holds instead
    # By relative path: kept beside the dataset. Whoever makes rows need not share a disk
    files: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Row:
    """One problem with its outcome."""

    index: int
    seed: int
    parameters: Array | None  # (p,) None if the problem could not be drawn
    answer: RowAnswer


class RowSource(Protocol, Generic[Drawn]):
    """A sampler with a solver; made once in each worker."""

    @property
    def frame(self) -> DatasetFrame:
        """Return what its rows share."""

    def draw(self, rng: np.random.Generator) -> Drawn:
        """Return a problem; the same for the same state of the generator."""

    def parameters(self, drawn: Drawn) -> Array:
        """Its parameters (p,)."""

    def solve(self, drawn: Drawn) -> RowAnswer:
        """Its answer, through the problem's own check."""


def derive_seed(seed: int, row: int) -> int:
    """Return the seed of a row, 63 bits: independent of other rows and of who computes it."""
    child = np.random.SeedSequence(seed, spawn_key=(row,))
    return int(child.generate_state(1, np.uint64)[0] >> 1)


def build_dataset(frame: DatasetFrame, rows: Sequence[Row]) -> Dataset:
    """Return rows in order of their index, as columns."""
    ordered = sorted(rows, key=lambda row: row.index)
    n = len(ordered)
    parameters = np.full((n, len(frame.parameter_names)), math.nan)
    integers = np.full((n, len(frame.integer_names)), -1, np.int64)
    solution: dict[str, NDArray[Any]] = {}
    for name, layout in frame.layouts.items():
        shape = (n, *(int(k) for k in layout.shape[1:]))
        solution[name] = np.full(shape, *_EMPTY[layout.kind])
    objective = np.full(n, math.nan)
    for k, row in enumerate(ordered):
        if row.parameters is not None:
            parameters[k] = row.parameters
        answer = row.answer
        if answer.status in ANSWERED and answer.solution is not None:
            objective[k] = answer.objective
            if answer.integers is not None:
                integers[k] = answer.integers
            for name, value in answer.solution.items():
                solution[name][k] = value
        elif answer.evidence is not None:
            for name, value in answer.evidence.items():
                solution[name][k] = value
    for name, layout in frame.layouts.items():
        if layout.kind == "text":
            solution[name] = solution[name].astype(np.str_)
    return Dataset(
        frame=frame,
        parameters=parameters,
        feasible=np.array([row.answer.status in ANSWERED for row in ordered], bool),
        solution=solution,
        integers=integers,
        objective=objective,
        bound=np.array([row.answer.bound for row in ordered], float),
        time=np.array([row.answer.time for row in ordered], float),
        seed=np.array([row.seed for row in ordered], np.int64),
        row=np.array([row.index for row in ordered], np.int64),
        status=tuple(row.answer.status for row in ordered),
        message=tuple(row.answer.message for row in ordered),
    )
