"""Where `--save-model` may write."""

from __future__ import annotations

from pathlib import Path

from climbplan.errors import UsageError


def check_model_path(path: Path | None) -> None:
    """Refuse a directory and a place that does not exist, before anything is solved.

    Raises:
        UsageError: it is one of these.
    """
    if path is None:
        return
    if path.is_dir():
        raise UsageError(f"--save-model {path}: is a directory, expected a file to write")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--save-model {path}: no such directory {str(path.parent)!r}")
