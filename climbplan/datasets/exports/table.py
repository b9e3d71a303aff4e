"""A dataset as a table: CSV, or Parquet where pyarrow is installed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from climbplan.errors import MissingSolver
from climbplan.store.atomic_file import replace_atomically
from climbplan.store.csv_file import write_csv
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import read_dataset_file

FORMATS = ("csv", "parquet")


def build_columns(data: Dataset) -> dict[str, NDArray[Any]]:
    """Return every column (n,) by name: parameters, outcome, integers, numbers of the solution."""
    table: dict[str, NDArray[Any]] = {"row": data.row, "seed": data.seed}
    for name, values in zip(data.frame.parameter_names, data.parameters.T, strict=True):
        table[f"parameters.{name}"] = values
    table["feasible"] = data.feasible
    table["status"] = np.array(data.status, object)
    for name in ("objective", "bound", "time"):
        table[name] = vars(data)[name]
    for name, whole in zip(data.frame.integer_names, data.integers.T, strict=True):
        table[f"integers.{name}"] = whole
    for name, value in data.solution.items():
        flat = value.reshape(data.count, -1)
        for k in range(flat.shape[1]):
            place = "".join(f"_{i}" for i in np.unravel_index(k, value.shape[1:]))
            table[f"solution.{name}{place}"] = flat[:, k]
    if data.train is not None and data.test is not None:
        table |= {"train": data.train, "test": data.test}
    table["message"] = np.array(data.message, object)
    return table


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write a dataset's file as `write_table`.

    Raises PlanFileError for a damaged one.
    """
    write_table(read_dataset_file(path), out)


def write_table(data: Dataset, out: Path | TextIO) -> None:
    """Write CSV: one line a row, exact numbers, empty where there is none.

    Raises UsageError where it cannot be written.
    """
    table = build_columns(data)
    write_csv(out, table, _iterate_lines(list(table.values())))


def export_parquet(data: Dataset, path: Path) -> None:
    """Write Parquet, with units in the columns' metadata.

    Raises MissingSolver without pyarrow, UsageError where it cannot be written.
    """
    try:
        import pyarrow as arrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise MissingSolver(
            "Parquet needs pyarrow, which is not installed: pip install 'climbplan[data]' "
            "(or export CSV)"
        ) from error
    columns_by_name = build_columns(data)
    arrays = [
        arrow.array(values.tolist(), arrow.string())
        if values.dtype == object
        else arrow.array(values)
        for values in columns_by_name.values()
    ]
    fields = [
        arrow.field(name, array.type, metadata={"units": _select_unit(data, name)})
        for name, array in zip(columns_by_name, arrays, strict=True)
    ]
    about = {"problem": data.frame.problem, "spec": data.spec_text, "name": data.name}
    table = arrow.Table.from_arrays(arrays, schema=arrow.schema(fields, metadata=about))
    with replace_atomically(path) as temporary_path:
        parquet.write_table(table, temporary_path)


def _iterate_lines(values: list[NDArray[Any]]) -> Iterator[list[str]]:
    for k in range(len(values[0])):
        yield [_format_cell(column[k]) for column in values]


def _format_cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return str(value)


def _select_unit(data: Dataset, column: str) -> str:
    if column in ("objective", "bound"):
        return data.frame.objective_unit
    return "s" if column == "time" else ""
