"""Specs of the live page: examples, the files of one folder, and what is wrong with a text."""

from __future__ import annotations

import dataclasses
import re
import threading
from pathlib import Path
from typing import Any

from climbplan.api.validating import check_spec
from climbplan.errors import ClimbplanError, SpecError, UsageError
from climbplan.live.planning import COMMANDS
from climbplan.schema.examples import list_example_names, read_example, read_example_data
from climbplan.schema.loading import load_source
from climbplan.schema.source import SourceText, read_source
from climbplan.store.atomic_file import replace_atomically

_FILE_NAME = re.compile(r"[A-Za-z0-9_][\w.-]{0,100}\.ya?ml", re.ASCII)
_MAX_FILES = 500  # that are listed
_checking = threading.Lock()  # scenes are built one at a time: CasADi and Numba are not re-entrant


def list_specs(folder: Path) -> dict[str, list[str]]:
    """Return the names of spec files in a folder, and of examples that need no other file."""
    names = (path.name for path in folder.iterdir() if path.is_file())
    return {
        "files": sorted(name for name in names if _FILE_NAME.fullmatch(name))[:_MAX_FILES],
        "examples": [
            name
            for kind in COMMANDS
            for name in list_example_names(kind)
            if not read_example_data(name)
        ],
    }


def read_spec(folder: Path, source: str, name: str) -> str:
    """Return the text of a spec.

    Args:
        folder: the folder that is served.
        source: "file" or "example".
        name: name of the file, or of the example.

    Raises:
        UsageError: there is no such example, or the name leads out of the folder.
        SpecError: the file is missing, too large or no text.
    """
    if source == "example":
        return read_example(name)
    return read_source(_locate(folder, name)).text


def save_spec(folder: Path, name: str, text: str, replace: bool) -> None:
    """Write a spec into the folder, completely or not at all.

    Raises:
        UsageError: the name is no plain file name, the file exists and `replace` is not set, or it
            cannot be written.
    """
    path = _locate(folder, name)
    if path.exists() and not replace:
        raise UsageError(f"{name}: already exists")
    with replace_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _locate(folder: Path, name: str) -> Path:
    """Return the path of a spec in a folder; raises UsageError for names that lead elsewhere."""
    if not _FILE_NAME.fullmatch(name):
        raise UsageError(f"expected a file name such as my_climb.yaml, got {name[:100]!r}")
    path = folder / name
    if path.is_symlink():
        raise UsageError(f"{name}: a link, expected a file")
    return path


def check_text(folder: Path, text: str) -> dict[str, Any]:
    """Return what `climbplan validate` says of a text.

    Args:
        folder: the directory that relative paths in the text start from.
        text: YAML of a spec of any kind.

    Returns:
        `valid`, `kind` ("" where there are mistakes), `mistakes` (each with `key`, `line`,
        `message`, `suggestion`), and `warnings`.
    """
    if not text.strip():
        return _describe_mistakes([{"key": "", "line": None, "message": "an empty spec"}])
    try:
        with _checking:
            loaded = load_source(SourceText("spec", "spec", folder, text))
            valid = check_spec(loaded)
    except SpecError as error:
        return _describe_mistakes([dataclasses.asdict(mistake) for mistake in error.mistakes])
    except ClimbplanError as error:  # a robot or a scan that cannot be read
        return _describe_mistakes([{"key": "", "line": None, "message": str(error)}])
    return {
        "valid": True,
        "kind": valid.kind,
        "mistakes": [],
        "warnings": list(valid.warnings),
    }


def _describe_mistakes(mistakes: list[dict[str, Any]]) -> dict[str, Any]:
    return {"valid": False, "kind": "", "mistakes": mistakes, "warnings": []}
