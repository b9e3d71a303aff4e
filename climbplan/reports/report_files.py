"""The files of a report: numbers that JSON can hold, each file written aside and renamed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from climbplan.errors import UsageError
from climbplan.store.atomic_file import replace_atomically


def write_files(
    directory: Path, report: Mapping[str, Any], page: str, images: Mapping[str, bytes]
) -> None:
    """Write report.json, report.html and figures/<name>.png into a directory.

    Args:
        directory: Directory to write into; it is created if it is missing.
        report: JSON-ready values without NaN and infinity.
        page: Text of report.html.
        images: PNG files by name.

    Raises:
        UsageError: The directory cannot be written to.
    """
    try:
        (directory / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{directory}: cannot be written: {reason}") from error
    for name, image in images.items():
        _write(directory / "figures" / f"{name}.png", image)
    write_values(directory, report)
    _write(directory / "report.html", page.encode())


def write_values(directory: Path, report: Mapping[str, Any]) -> None:
    """Write report.json into a directory that exists."""
    text = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    _write(directory / "report.json", f"{text}\n".encode())


def replace_non_finite(value: Any) -> Any:
    """Return the same without NaN and infinities, which JSON cannot hold."""
    if isinstance(value, Mapping):
        return {str(key): replace_non_finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_non_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write(path: Path, content: bytes) -> None:
    with replace_atomically(path) as temporary_path:
        temporary_path.write_bytes(content)
