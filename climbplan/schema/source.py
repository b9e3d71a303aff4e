"""Read the text of a spec file, or explain why there is none."""

from __future__ import annotations

import difflib
import os
import stat
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from climbplan.errors import SpecError, SpecMistake

NAME_VARIABLE = "CLIMBPLAN_SPEC_NAME"  # environment variable: name of a spec on standard input
LARGEST_SPEC = 5_000_000  # [bytes]
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class SourceText:
    """What was read, and the names it goes by."""

    shown: str  # as in messages
    name: str  # file stem; of standard input "stdin" or what NAME_VARIABLE says
    directory: Path  # that relative paths in the text start from
    text: str


def read_source(source: str | Path) -> SourceText:
    """Read a spec from a file, or from standard input if `source` is `-`.

    Who writes to standard input may name the spec by the environment variable NAME_VARIABLE.

    Raises:
        SpecError: nothing is there, it is a directory, too large, empty, a plan, or not UTF-8.
    """
    if str(source) == "-":
        name = os.environ.get(NAME_VARIABLE) or "stdin"
        content = _read_bounded(sys.stdin.buffer, name)
        return SourceText(name, name, Path.cwd(), _decode_text(content, name))
    path = Path(source)
    label = str(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise _build_error(label, "a directory, expected a YAML file")
        if status.st_size > LARGEST_SPEC:
            raise _report_size(label, status.st_size)
        with path.open("rb") as stream:
            content = _read_bounded(stream, label)
    except FileNotFoundError:
        raise _report_missing(path) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise _build_error(label, f"cannot be read: {reason}") from error
    return SourceText(label, path.stem, path.resolve().parent, _decode_text(content, label))


def _build_error(
    label: str, message: str, line: int | None = None, suggestion: str | None = None
) -> SpecError:
    return SpecError(label, [SpecMistake("", message, line, suggestion)])


def _report_missing(path: Path) -> SpecError:
    if not path.parent.is_dir():
        return _build_error(str(path), f"no such file, and no directory {str(path.parent)!r}")
    specs = {p.stem: p.name for p in path.parent.iterdir() if p.suffix in (".yaml", ".yml")}
    matches = difflib.get_close_matches(path.stem, list(specs), n=1)
    suggestion = str(path.with_name(specs[matches[0]])) if matches else None
    hint = "" if matches else "; `climbplan new climb` writes an example"
    return _build_error(str(path), f"no such file{hint}", suggestion=suggestion)


def _report_size(label: str, size: int | None) -> SpecError:
    how_large = f"{size / 1e6:.1f} MB" if size else f"more than {LARGEST_SPEC / 1e6:.0f} MB"
    return _build_error(
        label, f"too large: {how_large}, a spec has {LARGEST_SPEC / 1e6:.0f} at most"
    )


def _read_bounded(stream: BinaryIO, label: str) -> bytes:
    # Pipes and devices have no size beforehand: never read more than one byte past the limit.
    content = stream.read(LARGEST_SPEC + 1)
    if len(content) > LARGEST_SPEC:
        raise _report_size(label, None)
    return content


def _decode_text(content: bytes, label: str) -> str:
    if content.startswith(HDF5_SIGNATURE):
        raise _build_error(
            label,
            "a plan or data file (HDF5), expected a YAML spec; "
            f"to check a plan: `climbplan verify {label}`",
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        if b"\0" in content and not content.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise _build_error(label, "a binary file, expected a YAML spec") from None
        byte = content[error.start]
        message = f"not UTF-8 text: byte 0x{byte:02x}; save the file as UTF-8"
        raise _build_error(label, message, line) from None
    if "\0" in text:
        raise _build_error(label, "a binary file, expected a YAML spec")
    if not text.strip():
        raise _build_error(label, "empty; `climbplan new climb` writes an example")
    return text
