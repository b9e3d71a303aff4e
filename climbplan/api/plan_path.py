"""Find the file that a PLAN argument stands for."""

from __future__ import annotations

from pathlib import Path

from climbplan.errors import PlanFileError

PLAN_FILE = "plan.h5"
DATASET_FILE = "dataset.h5"


def find_plan(path: Path) -> Path:
    """Return a plan file, or the one in an output directory.

    Raises:
        PlanFileError: there is none at `path`.
    """
    if path.is_dir():
        for name in (PLAN_FILE, DATASET_FILE):
            if (path / name).is_file():
                return path / name
        raise PlanFileError(f"{path}: a directory without {PLAN_FILE} or {DATASET_FILE}")
    if not path.exists():
        raise PlanFileError(f"{path}: no such file")
    return path
