"""Answers to stated programs as HDF5 files, format `climbplan/program`.

parameters (n, p)   features (n, d)     columns of parameters: attribute `parameter_blocks`
x (n, N)            lower, upper (N)    columns: attribute `variable_blocks` (JSON: name, shape,
                                        start, unit, integer); NaN in rows without an answer
assignment (n, C)   status, objective, bound, gap, time, method, winner, tried, found (n)
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.deprecation import current_method_name
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_datasets
from climbplan.store.program_plan import (
    Layouts,
    ParameterBlock,
    ProgramPlan,
    ProgramTotals,
    VariableBlock,
)
from climbplan.store.root_attributes import read_root, require_other, write_root

FORMAT = "climbplan/program"
FORMAT_VERSION = 1
STATUSES = ("optimal", "feasible", "infeasible", "limit")

_ARRAYS = {
    "parameters": DatasetLayout(("n", "p")),
    "features": DatasetLayout(("n", "d")),
    "x": DatasetLayout(("n", "N")),
    "assignment": DatasetLayout(("n", "C"), kind="int"),
    "found": DatasetLayout(("n",), kind="bool"),
    "objective": DatasetLayout(("n",)),
    "bound": DatasetLayout(("n",), may_be_infinite=True),
    "gap": DatasetLayout(("n",), may_be_infinite=True),
    "time": DatasetLayout(("n",), "s"),
    "tried": DatasetLayout(("n",), kind="int"),
}
_BOUNDS = {
    "lower": DatasetLayout(("N",), may_be_infinite=True),
    "upper": DatasetLayout(("N",), may_be_infinite=True),
}
_TEXTS = {name: DatasetLayout(("n",), kind="text") for name in ("status", "method", "winner")}
_OPTIONAL = ("objective", "bound", "gap")  # of all rows, left out where a row has none
_NAN_WITHOUT_ANSWER = ("x", "objective", "gap")


def write_program(plan: ProgramPlan, path: Path) -> None:
    """Write answers; the file appears whole or not at all. Raises UsageError if it cannot."""
    fields = vars(plan)
    with create_store(path) as file:
        write_root(
            file,
            plan,
            FORMAT,
            FORMAT_VERSION,
            texts={"problem": plan.problem, "status": plan.overall},
            numbers={
                "tolerance": plan.tolerance,
                **{name: vars(plan.totals)[name] for name in _OPTIONAL},
            },
            objects={
                "timings": dict(plan.timings),
                "solvers": dict(plan.solvers),
                "sizes": dict(plan.sizes),
                "parameter_blocks": [asdict(b) for b in plan.layouts.parameters],
                "variable_blocks": [asdict(b) for b in plan.layouts.variables],
            },
        )
        write_datasets(file, (_ARRAYS | _TEXTS), fields)
        write_datasets(file, _BOUNDS, vars(plan.layouts))


def read_program(path: Path) -> ProgramPlan:
    """Return the answers in a file, as they were written; nothing in it is ever run.

    Raises PlanFileError for another format, missing or misshapen data, and for NaN in a row that
    claims an answer.
    """
    with open_store(path) as file:
        return _read(Reader(path, file))


def _read(reader: Reader) -> ProgramPlan:
    require_other(reader, FORMAT_VERSION, FORMAT, "a plan file of `climbplan solve`")
    arrays: dict[str, Any] = reader.datasets("", _ARRAYS)
    bounds = reader.datasets("", _BOUNDS)
    texts: dict[str, Any] = reader.datasets("", _TEXTS)
    texts["method"] = tuple(current_method_name("program", name) for name in texts["method"])
    has_answer = arrays["found"]
    for name in reader.not_finite:
        bad = np.isnan(arrays[name]) if name in arrays else np.array([True])
        rows = bad.reshape(len(bad), -1).any(axis=1)
        if name not in _NAN_WITHOUT_ANSWER or (rows & has_answer).any():
            raise reader.refuse(f"NaN in {name}")
    foreign = sorted(set(texts["status"]) - set(STATUSES))
    if foreign:
        raise reader.refuse(f"status {foreign[0]!r}, expected one of {', '.join(STATUSES)}")
    answered = np.isin(texts["status"], ("optimal", "feasible"))
    if (answered != has_answer).any():
        row = int(np.flatnonzero(answered != has_answer)[0])
        raise reader.refuse(f"row {row}: status {texts['status'][row]!r} and `found` disagree")
    layouts = Layouts(
        _read_parameters(reader), _read_variables(reader), bounds["lower"], bounds["upper"]
    )
    return ProgramPlan(
        **read_root(reader),
        problem=reader.text("", "problem"),
        layouts=layouts,
        **arrays,
        **texts,
        tolerance=reader.number("", "tolerance"),
        timings=reader.figures("timings"),
        solvers=reader.figures("solvers"),
        sizes=reader.mapping("sizes"),
        stored_totals=_read_totals(reader),
    )


def _read_totals(reader: Reader) -> ProgramTotals:
    numbers = {
        name: reader.number("", name) if reader.has_attribute("", name) else None
        for name in _OPTIONAL
    }
    return ProgramTotals(reader.text("", "status"), **numbers)


def mark_program(plan: ProgramPlan, verified: bool) -> ProgramPlan:
    """Return the plan with the outcome of its verification."""
    return replace(plan, verified=verified)


def _read_parameters(reader: Reader) -> tuple[ParameterBlock, ...]:
    blocks = [
        ParameterBlock(_read_field(reader, entry, "name", str), _read_shape(reader, entry))
        for entry in _read_entries(reader, "parameter_blocks")
    ]
    _require_columns(reader, "p", sum(math.prod(b.shape) for b in blocks))
    return tuple(blocks)


def _read_variables(reader: Reader) -> tuple[VariableBlock, ...]:
    blocks, next_column = [], 0
    for entry in _read_entries(reader, "variable_blocks"):
        block = VariableBlock(
            _read_field(reader, entry, "name", str),
            _read_shape(reader, entry),
            _read_field(reader, entry, "start", int),
            _read_field(reader, entry, "unit", str),
            _read_field(reader, entry, "integer", bool),
        )
        if block.start != next_column:
            raise reader.refuse(
                f"variable block {block.name!r} does not start at column {next_column}"
            )
        next_column = block.stop
        blocks.append(block)
    _require_columns(reader, "N", next_column)
    return tuple(blocks)


def _require_columns(reader: Reader, dimension: str, count: int) -> None:
    if reader.dimensions[dimension] != count:
        raise reader.refuse(f"{reader.dimensions[dimension]} columns, its blocks have {count}")


def _read_entries(reader: Reader, name: str) -> list[dict[str, Any]]:
    value = reader.json("", name)
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise reader.refuse(f"attribute {name} is not a list of blocks")
    return value


def _read_field(reader: Reader, entry: dict[str, Any], key: str, kind: type[Any]) -> Any:
    value = entry.get(key)
    if not isinstance(value, kind):
        raise reader.refuse(f"a block's {key!r} is {value!r}, expected {kind.__name__}")
    return value


def _read_shape(reader: Reader, entry: dict[str, Any]) -> tuple[int, ...]:
    shape = entry.get("shape")
    if not isinstance(shape, list) or not all(type(k) is int and 0 <= k < 2**31 for k in shape):
        raise reader.refuse(f"a block's shape is {shape!r}, expected whole numbers")
    return tuple(shape)
