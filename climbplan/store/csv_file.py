"""CSV written whole or not at all, or to a stream."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

from climbplan.store.atomic_file import replace_atomically

_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # how cells begin that spreadsheets compute


def write_csv(
    out: Path | TextIO, header: Iterable[str], rows: Iterable[Iterable[str | float]]
) -> None:
    """Write one header line, then rows whose numbers keep their full precision.

    Raises UsageError if a file at `out` cannot be written.
    """
    if isinstance(out, Path):
        with (
            replace_atomically(out) as temporary_path,
            temporary_path.open("w", encoding="utf-8", newline="") as stream,
        ):
            _write(stream, header, rows)
    else:
        _write(out, header, rows)


def _write(stream: TextIO, header: Iterable[str], rows: Iterable[Iterable[str | float]]) -> None:
    writer = SafeWriter(stream)
    writer.writerow(header)
    writer.writerows(rows)


class SafeWriter:
    """A CSV writer whose texts no spreadsheet takes for formulas: they begin with an apostrophe."""

    def __init__(self, stream: TextIO) -> None:
        self._writer = csv.writer(stream, lineterminator="\n")

    def writerow(self, row: Iterable[object]) -> None:
        """Write one row."""
        self._writer.writerow([_escape_formula(cell) for cell in row])

    def writerows(self, rows: Iterable[Iterable[object]]) -> None:
        """Write rows."""
        for row in rows:
            self.writerow(row)


def _escape_formula(cell: object) -> object:
    if not isinstance(cell, str) or not cell.startswith(_FORMULA):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell
