"""Checks of a dataset of motions: files are those of the rows, and keep the limits of measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.datasets.motions.rows import KIND, compute_digest
from climbplan.errors import PlanFileError, UsageError
from climbplan.motions.measure import measure_motion
from climbplan.motions.motion_file import read_motion_file
from climbplan.store.dataset import Dataset

_COLUMNS = ("usable", "motion", "sha256", "terrain", "terrain_sha256")
_FILES = (("motion", "sha256"), ("terrain", "terrain_sha256"))


def require_columns(data: Dataset, path: Path) -> None:
    """Raise PlanFileError if a dataset lacks a column of motions."""
    missing = [name for name in _COLUMNS if name not in data.solution]
    if missing:
        raise PlanFileError(f"{path}: no solution/{missing[0]}, which datasets of {KIND} have")


def count_unsound_rows(data: Dataset) -> int:
    """Count rows that claim to be usable without an answer, or have files and are not usable."""
    usable = data.solution["usable"].astype(bool)
    has_motion = data.solution["motion"] != ""
    return int(((usable & ~data.feasible) | (usable != has_motion)).sum())


def find_changed_files(data: Dataset, folder: Path) -> Array:
    """Return how many files of each row (n,) are missing or have other bytes than their SHA-256.

    Args:
        data: The rows.
        folder: Of the dataset, that paths start from.
    """
    changed = np.zeros(data.count)
    for paths, digests in _FILES:
        for row, (name, digest) in enumerate(
            zip(data.solution[paths], data.solution[digests], strict=True)
        ):
            if name:
                changed[row] += _compute_file_digest(folder / str(name)) != digest
    return changed


def count_broken_measures(data: Dataset, folder: Path) -> Array:
    """Return how many measures each usable row (n,) breaks; NaN where its file cannot be read."""
    broken = np.zeros(data.count)
    for row, name in enumerate(data.solution["motion"]):
        if name:
            try:
                checks = measure_motion(read_motion_file(folder / str(name)), {})
            except UsageError:
                broken[row] = np.nan
            else:
                broken[row] = sum(not check.passed for check in checks)
    return broken


def _compute_file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, empty if it cannot be read."""
    try:
        return compute_digest(path.read_bytes())
    except OSError:
        return ""
