"""Prepare the environment variables that libraries read, and refuse those that they fail on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from climbplan.errors import UsageError
from climbplan.progress import INTERVAL_VARIABLE

# Matrices here are small: threads in BLAS cost more than they give, several times more where other
# processes (the workers of --jobs) use the cores.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


@dataclass(frozen=True)
class _WholeNumber:
    """What a variable may hold."""

    lower: int
    upper: int
    meaning: str


_VARIABLES = {
    INTERVAL_VARIABLE: _WholeNumber(1, 86_400, "seconds between lines of progress"),
    "NUMBA_NUM_THREADS": _WholeNumber(1, 4096, "threads of compiled code"),
    # The end of the year 9999
    "SOURCE_DATE_EPOCH": _WholeNumber(0, 253_402_300_799, "seconds since 1970"),
}


def prepare_environment() -> None:
    """Set what libraries read when they are loaded: one thread in BLAS, figures off screen."""
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    os.environ["MPLBACKEND"] = "agg"  # a notebook's back end is not there outside of it


def require_sound_environment(variables: Mapping[str, str] = os.environ) -> None:
    """Raise UsageError for a variable whose value makes a library fail as it is loaded."""
    for name, allowed in _VARIABLES.items():
        text = variables.get(name)
        if text is None:
            continue
        try:
            is_allowed = allowed.lower <= int(text) <= allowed.upper
        except ValueError:
            is_allowed = False
        if not is_allowed:
            raise UsageError(
                f"environment variable {name}: expected a whole number of {allowed.meaning}, "
                f"{allowed.lower} to {allowed.upper}, got {text[:40]!r}; change or unset it"
            )
