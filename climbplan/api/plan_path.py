"""Which file a PLAN argument means."""

from __future__ import annotations

from pathlib import Path

from climbplan.errors import PlanFileError

PLAN_FILE = "plan.h5"
DATASET_FILE = "dataset.h5"


def find_plan(given: Path) -> Path:
    """The plan file that is given, or the one in the output directory that is.

    Raises:
        PlanFileError: there is none.
    """
    if given.is_dir():
        for name in (PLAN_FILE, DATASET_FILE):
            if (given / name).is_file():
                return given / name
        raise PlanFileError(f"{given}: a directory without {PLAN_FILE} or {DATASET_FILE}")
    if not given.exists():
        raise PlanFileError(f"{given}: no such file")
    return given
