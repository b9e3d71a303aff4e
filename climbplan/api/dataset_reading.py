"""A dataset's file reported and exported as those of plans are."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from climbplan.datasets import tables
from climbplan.datasets.pages import report as dataset_report
from climbplan.datasets.verification import MEANINGS, verification_of
from climbplan.store.dataset_file import read_dataset_file
from climbplan.verification.verification import Verification


def write_report(path: Path, directory: Path, verification: Verification | None = None) -> None:
    """Write page, figures and report.json into a directory; verification: as made already."""
    data = read_dataset_file(path)
    made = verification or verification_of(data, path)
    dataset_report.write_report(data, directory, made, MEANINGS)


def report_dict(path: Path) -> dict[str, object]:
    """The report as plain values."""
    data = read_dataset_file(path)
    return dataset_report.report_dict(data, verification_of(data, path))


def export_csv(path: Path, out: Path | TextIO) -> None:
    """All rows as CSV."""
    tables.export_csv(read_dataset_file(path), out)
