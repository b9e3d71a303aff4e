"""Report files put into a new directory, or into one that exists: each whole."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from climbplan.cli.output_directory import OutputDirectory
from climbplan.errors import UsageError

REPORT_FILES = ("report.json", "report.html", "figures")


def place_report(target: Path, write: Callable[[Path], None], replace: bool) -> None:
    """Let `write` make a report aside, then move its files into `target`.

    Raises:
        UsageError: a report is there and `replace` is not set, or nothing can be written there.
    """
    present = [name for name in REPORT_FILES if (target / name).exists()]
    if present and not replace:
        raise UsageError(f"{target}: already holds {present[0]}; --force replaces it")
    if not target.exists():
        with OutputDirectory(target) as directory:
            write(directory.path)
            directory.publish()
        return
    try:
        aside = Path(tempfile.mkdtemp(prefix=".report.", dir=target))
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from error
    try:
        write(aside)
        for entry in aside.iterdir():
            if entry.is_dir():
                shutil.rmtree(target / entry.name, ignore_errors=True)
            os.replace(entry, target / entry.name)
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
