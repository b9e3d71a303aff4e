"""CSV written whole or not at all, or to a stream."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

from climbplan.plans.atomic_file import written_aside


def write_csv(
    out: Path | TextIO, header: Iterable[str], rows: Iterable[Iterable[str | float]]
) -> None:
    """One header line, then rows whose numbers keep their full precision.

    Raises UsageError if a file at `out` cannot be written.
    """
    if isinstance(out, Path):
        with written_aside(out) as aside, aside.open("w", encoding="utf-8", newline="") as stream:
            _write(stream, header, rows)
    else:
        _write(out, header, rows)


def _write(stream: TextIO, header: Iterable[str], rows: Iterable[Iterable[str | float]]) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
