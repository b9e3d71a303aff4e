"""Results of `zoo`, kept robot by robot so that a run goes on where another ended."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from climbplan.errors import UsageError
from climbplan.store.csv_file import write_csv

FILE = "results.csv"
_READ: dict[str, Callable[[str], str | float]] = {
    "mass": float,
    "legs": int,
    "cpu": float,
    "proposed": float,
    "planned": lambda value: value == "True",
}


@dataclass(frozen=True)
class Row:
    """One cell of the table."""

    robot: str
    mass: float  # [kg]; 0 where nothing is proposed
    legs: int
    proposed: float  # [s] CPU of the proposal, with the walk on ground that settles how it stands
    column: str
    planned: bool  # and verified
    simulated: str
    words: str
    cpu: float  # [s]


def kept(out: Path) -> list[Row]:
    """Rows of earlier runs; raises UsageError for a file that holds something else."""
    path = out / FILE
    if not path.exists():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return [
                Row(**{key: _READ.get(key, str)(value) for key, value in row.items()})  # type: ignore[arg-type]
                for row in csv.DictReader(stream)
            ]
    except (TypeError, ValueError) as error:
        raise UsageError(f"{path}: no results of `zoo`: {error}") from error


def keep(out: Path, rows: Sequence[Row]) -> None:
    """Write all rows; raises UsageError where that cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{out}: cannot be created: {error.strerror}") from error
    names = [field.name for field in fields(Row)]
    write_csv(out / FILE, names, [asdict(row).values() for row in rows])
