"""Many solved problems of one kind: what a file of format `climbplan/dataset` holds.

A row is one problem: its parameters, its solution and integers, cost, time, and the seed that it
was drawn with. A problem without an answer is a row too: `feasible` false, `status` and `message`
say why.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.store.hdf5_layout import DatasetLayout, Kind

STATUSES = ("optimal", "feasible", "infeasible", "limit", "failed")
ANSWERED = ("optimal", "feasible")
_SEQUENCES = ("status", "message")
_COLUMNS = ("parameters", "feasible", "integers", "objective", "bound", "time", "seed", "row")


def build_solution_layout(
    shape: Sequence[int], units: str = "", frame: str = "", kind: Kind = "float"
) -> DatasetLayout:
    """Return the layout of one array of a solution, `shape` without its rows.

    Rows without an answer have NaN, -1, False or empty text. Texts whose unit is `path` are paths
    relative to the folder of the dataset.
    """
    return DatasetLayout(("n", *shape), units, frame, kind, may_be_nan=kind == "float")


@dataclass(frozen=True)
class DatasetFrame:
    """What all rows of a dataset share: rows of equal frames may be put together."""

    kind: str  # of problem: "bookshelf", "program"
    problem: str  # its name
    facts: Mapping[str, Any]  # plain values that the kind needs to understand and check its rows
    parameter_names: tuple[str, ...]  # (p,)
    integer_names: tuple[str, ...]  # (q,)
    layouts: Mapping[str, DatasetLayout]  # of the solution's arrays: `build_solution_layout`
    objective_unit: str = ""


@dataclass(frozen=True)
class Dataset:
    """n rows; those that are not feasible have NaN and -1 where there is nothing to tell."""

    frame: DatasetFrame
    parameters: Array  # (n, p) NaN where not even the problem could be drawn
    feasible: BoolArray  # (n,) an answer is there and was checked
    solution: Mapping[str, NDArray[Any]]  # name -> (n, ...), as `frame.layouts` say
    integers: IntArray  # (n, q) -1 without an answer
    objective: Array  # (n,) NaN without an answer
    bound: Array  # (n,) minus infinity where nothing is proved
    time: Array  # (n,) [s] of the solver
    seed: IntArray  # (n,) `numpy.random.default_rng(seed)` draws the row again
    row: IntArray  # (n,) its number in the run that made it
    status: tuple[str, ...]  # (n,) of STATUSES; failed: the worker died, hung or raised
    message: tuple[str, ...]  # (n,) why there is no answer, or what deserves a remark
    name: str = ""
    title: str = ""
    spec_text: str = ""
    spec_sha256: str = ""
    base_seed: int = 0
    train: BoolArray | None = None  # (n,) and `test`: masks that never share a problem
    test: BoolArray | None = None
    timings: Mapping[str, Any] = field(default_factory=dict)
    solvers: Mapping[str, Any] = field(default_factory=dict)
    verified: bool = False
    created: str = ""
    climbplan_version: str = ""

    @property
    def count(self) -> int:
        """n."""
        return len(self.feasible)

    @property
    def drawn(self) -> BoolArray:
        """Rows (n,) that hold a problem; the sampler failed in the others."""
        return np.asarray(np.isfinite(self.parameters).all(axis=1), bool)

    @property
    def statuses(self) -> dict[str, int]:
        """Return how many rows ended how."""
        counts = Counter(self.status)
        return {name: counts[name] for name in STATUSES if counts[name]}

    @property
    def overall(self) -> str:
        """One status for all: the weakest of the answered rows, `infeasible` or `limit` of none."""
        if self.feasible.any():
            return "feasible" if "feasible" in self.status else "optimal"
        return "infeasible" if set(self.status) == {"infeasible"} else "limit"

    def hashes(self) -> tuple[str, ...]:
        """Return a hash of each row's parameters (n,): equal ones are the same problem."""
        rows = np.ascontiguousarray(self.parameters) + 0.0  # no minus zero
        return tuple(hashlib.sha256(row.tobytes()).hexdigest()[:16] for row in rows)

    def move(self, start: Path, end: Path) -> Self:
        """Return the dataset for another folder: its paths lead to the same files from there.

        Args:
            start: Folder of the dataset so far.
            end: Folder that it is written to.
        """
        names = [name for name, layout in self.frame.layouts.items() if layout.units == "path"]
        if not names or start.resolve() == end.resolve():
            return self
        prefix = os.path.relpath(start.resolve(), end.resolve())
        paths = {
            name: np.array(
                [
                    os.path.normpath(f"{prefix}/{path}") if path else ""
                    for path in self.solution[name]
                ],
                np.str_,
            )
            for name in names
        }
        return replace(self, solution={**self.solution, **paths})

    def rows(self, chosen: IntArray) -> Self:
        """Return the dataset of some rows (k,), masks left out."""
        arrays: dict[str, Any] = {name: vars(self)[name][chosen] for name in _COLUMNS}
        texts: dict[str, Any] = {
            name: tuple(vars(self)[name][k] for k in chosen) for name in _SEQUENCES
        }
        solution = {name: value[chosen] for name, value in self.solution.items()}
        return replace(self, **arrays, **texts, solution=solution, train=None, test=None)

    @classmethod
    def join(cls, datasets: Sequence[Self]) -> Self:
        """Return all rows of datasets of one frame, in order; the rest is that of the first.

        Raises UsageError if the frames differ.
        """
        first = datasets[0]
        for dataset in datasets[1:]:
            if dataset.frame != first.frame:
                raise UsageError(
                    f"{dataset.name or 'a dataset'}: "
                    f"{describe_frame_difference(first.frame, dataset.frame)}"
                )
        arrays: dict[str, Any] = {
            name: np.concatenate([vars(dataset)[name] for dataset in datasets]) for name in _COLUMNS
        }
        texts: dict[str, Any] = {
            name: tuple(text for dataset in datasets for text in vars(dataset)[name])
            for name in _SEQUENCES
        }
        solution = {
            name: np.concatenate([dataset.solution[name] for dataset in datasets])
            for name in first.solution
        }
        return replace(first, **arrays, **texts, solution=solution, train=None, test=None)


def describe_frame_difference(first: DatasetFrame, second: DatasetFrame) -> str:
    """Return what two frames differ in, in words; "" if in nothing."""
    for label, first_value, second_value in (
        ("kind of problem", first.kind, second.kind),
        ("problem", first.problem, second.problem),
    ):
        if first_value != second_value:
            return f"another {label}: {second_value!r}, expected {first_value!r}"
    for key in sorted({*first.facts, *second.facts}):
        if first.facts.get(key) != second.facts.get(key):
            return (
                f"another {key.replace('_', ' ')}: {second.facts.get(key)!r}, "
                f"expected {first.facts.get(key)!r}"
            )
    return "" if first == second else "other columns"
