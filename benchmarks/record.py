"""The JSON record of a run: what was measured, where, with what, and the results."""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.cli.dependencies import PARTS

_ROOT = Path(__file__).parents[1]
_GAP = re.compile(r" {2,}")  # between two cells of a printed table


def describe_start() -> dict[str, str | None]:
    """Return the date and the commit, which may be others when a long run ends."""
    return {"date": datetime.now(UTC).isoformat(timespec="seconds"), "commit": read_commit()}


def make_record(
    start: Mapping[str, str | None],
    benchmark: str,
    options: Mapping[str, Any],
    results: Mapping[str, Any],
    text: str,
) -> dict[str, Any]:
    """Return the record of a run in values that JSON holds; NaN and infinity become null.

    Args:
        start: As `describe_start` has it.
        benchmark: Name of the subcommand.
        options: Options of the run by name.
        results: Figures of the benchmark; empty for one that prints tables alone.
        text: Tables as printed.
    """
    return {
        "benchmark": benchmark,
        **start,
        "machine": {"platform": describe_platform(), "cpu_count": os.cpu_count()},
        "versions": list_versions(),
        "options": _plain(options),
        "results": {**_plain(results), "tables": split_tables(text)},
    }


def describe_platform() -> str:
    """Return system, release without the builder's suffix, and architecture."""
    release = platform.release().partition("-")[0]
    return f"{platform.system()} {release} {platform.machine()}"


def read_commit() -> str | None:
    """Return the commit of the clone, `-dirty` after it if files differ; None without git."""
    if not (_ROOT / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    with suppress(OSError, subprocess.CalledProcessError):
        done = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()
    return None


def list_versions() -> dict[str, str]:
    """Return the version of Python and of each package of `climbplan doctor` that is there."""
    versions = {"python": platform.python_version()}
    for part in PARTS:
        if part.package:
            with suppress(PackageNotFoundError):
                versions[part.package.lower()] = version(part.package)
    return versions


def split_tables(text: str) -> list[dict[str, Any]]:
    """Split printed tables into title, header and rows of cells.

    Cells stand two spaces or more apart. Lines of one cell belong to the title of the table that
    follows them; after the last table they make an entry without header and rows.
    """
    tables: list[dict[str, Any]] = []
    title: list[str] = []
    is_open = False
    for line in text.splitlines():
        cells = _GAP.split(line.rstrip())  # a first cell that is blank stays
        if sum(bool(cell) for cell in cells) < 2:
            title += [line.strip()] if line.strip() else []
            is_open = False
        elif is_open:
            tables[-1]["rows"].append(cells)
        else:
            tables.append({"title": "\n".join(title), "header": cells, "rows": []})
            title, is_open = [], True
    if title:
        tables.append({"title": "\n".join(title), "header": [], "rows": []})
    return tables


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
