"""The online controller's library from a dataset of walks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from climbplan.errors import UsageError
from climbplan.store.dataset_file import FORMAT, read_dataset_file
from climbplan.store.hdf5_reading import Reader, opened_store
from climbplan.walking.online.dataset_rows import KIND, task_of_frame, walk_of
from climbplan.walking.online.library import Library, joined, mirrored, sections_of, symmetric
from climbplan.walking.task.task import WalkTask


def is_dataset(path: Path) -> bool:
    """Whether a file says that it is a dataset; raises PlanFileError for one that is not HDF5."""
    with opened_store(path) as file:
        reader = Reader(path, file)
        return reader.has_attribute("", "format") and reader.text("", "format") == FORMAT


def library_of_dataset(path: Path, key: str, key_of: Callable[[WalkTask], str]) -> Library:
    """Sections of all walks of a dataset, numbered by walk, and their mirror images.

    key: of the task that they are to serve; key_of: makes it of a task. Raises PlanFileError for a
    damaged file, UsageError for walks of another task or no walks.
    """
    data = read_dataset_file(path)
    if data.frame.kind != KIND:
        raise UsageError(f"{path}: a dataset of {data.frame.kind!r}, not of walks")
    task = task_of_frame(data.frame, path)
    if key_of(task) != key:
        raise UsageError(f"{path}: made for another robot, reference or weights")
    rows = np.flatnonzero(data.feasible)
    if not len(rows):
        raise UsageError(f"{path}: no row has a walk")
    parts = [sections_of(*walk_of(task, data, int(row)), k) for k, row in enumerate(rows)]
    whole = joined(parts)
    return joined([whole, mirrored(task, whole)]) if symmetric(task) else whole
