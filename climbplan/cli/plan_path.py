"""Which file a PLAN argument means."""

from __future__ import annotations

from pathlib import Path

from climbplan.errors import PlanFileError

PLAN_FILE = "plan.h5"


def find_plan(given: Path) -> Path:
    """The plan file that is given, or the one in the output directory that is.

    Raises:
        PlanFileError: there is none.
    """
    if given.is_dir():
        if (given / PLAN_FILE).is_file():
            return given / PLAN_FILE
        raise PlanFileError(f"{given}: a directory without {PLAN_FILE}")
    if not given.exists():
        raise PlanFileError(f"{given}: no such file")
    return given
