"""Rows of results in a CSV file, so that a benchmark of hours goes on where another run ended."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from climbplan.errors import UsageError
from climbplan.store.csv_file import write_csv

T = TypeVar("T")


def read_rows(path: Path, row_type: type[T]) -> list[T]:
    """Return the rows of a file, none if there is no file.

    Args:
        path: The file, as `write_rows` writes it.
        row_type: A dataclass with fields of type str, int, float or bool.

    Raises:
        UsageError: The file holds something else.
    """
    if not path.exists():
        return []
    types = get_type_hints(row_type)
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return [
                row_type(**{key: _read(types[key], text) for key, text in row.items()})
                for row in csv.DictReader(stream)
            ]
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path}: no rows of {row_type.__name__}: {error}") from error


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Write rows of one dataclass, all of them, and the folder if need be.

    Raises:
        UsageError: The folder cannot be created.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path.parent}: cannot be created: {error.strerror}") from error
    names = [field.name for field in fields(rows[0])]
    write_csv(path, names, [asdict(row).values() for row in rows])


def _read(value_type: Any, text: str) -> Any:
    if value_type is bool:
        return {"True": True, "False": False}[text]
    return value_type(text)
