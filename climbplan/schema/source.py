"""The text of a spec file, or a clear word on why there is none."""

from __future__ import annotations

import difflib
import stat
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from climbplan.errors import SpecError, SpecMistake

LARGEST_SPEC = 5_000_000  # [bytes]
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class SourceText:
    """What was read, and the names it goes by."""

    shown: str  # as in messages
    name: str  # file stem, "stdin" for standard input
    directory: Path  # that relative paths in the text start from
    text: str


def read_source(source: str | Path) -> SourceText:
    """Read a spec from a file, or from standard input if `source` is `-`.

    Raises:
        SpecError: nothing is there, it is a directory, too large, empty, a plan, or not UTF-8.
    """
    if str(source) == "-":
        content = _at_most(sys.stdin.buffer, "stdin")
        return SourceText("stdin", "stdin", Path.cwd(), _decoded(content, "stdin"))
    path = Path(source)
    shown = str(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise _refusal(shown, "a directory, expected a YAML file")
        if status.st_size > LARGEST_SPEC:
            raise _too_large(shown, status.st_size)
        with path.open("rb") as stream:
            content = _at_most(stream, shown)
    except FileNotFoundError:
        raise _missing(path) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise _refusal(shown, f"cannot be read: {reason}") from error
    return SourceText(shown, path.stem, path.resolve().parent, _decoded(content, shown))


def _refusal(
    shown: str, message: str, line: int | None = None, suggestion: str | None = None
) -> SpecError:
    return SpecError(shown, [SpecMistake("", message, line, suggestion)])


def _missing(path: Path) -> SpecError:
    if not path.parent.is_dir():
        return _refusal(str(path), f"no such file, and no directory {str(path.parent)!r}")
    specs = {p.stem: p.name for p in path.parent.iterdir() if p.suffix in (".yaml", ".yml")}
    near = difflib.get_close_matches(path.stem, list(specs), n=1)
    suggestion = str(path.with_name(specs[near[0]])) if near else None
    hint = "" if near else "; `climbplan new climb` writes an example"
    return _refusal(str(path), f"no such file{hint}", suggestion=suggestion)


def _too_large(shown: str, size: int | None) -> SpecError:
    how_large = f"{size / 1e6:.1f} MB" if size else f"more than {LARGEST_SPEC / 1e6:.0f} MB"
    return _refusal(shown, f"too large: {how_large}, a spec has {LARGEST_SPEC / 1e6:.0f} at most")


def _at_most(stream: BinaryIO, shown: str) -> bytes:
    # Pipes and devices have no size beforehand: never read more than one byte past the limit.
    content = stream.read(LARGEST_SPEC + 1)
    if len(content) > LARGEST_SPEC:
        raise _too_large(shown, None)
    return content


def _decoded(content: bytes, shown: str) -> str:
    if content.startswith(HDF5_SIGNATURE):
        raise _refusal(
            shown,
            "a plan or data file (HDF5), expected a YAML spec; "
            f"to check a plan: `climbplan verify {shown}`",
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        if b"\0" in content and not content.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise _refusal(shown, "a binary file, expected a YAML spec") from None
        byte = content[error.start]
        message = f"not UTF-8 text: byte 0x{byte:02x}; save the file as UTF-8"
        raise _refusal(shown, message, line) from None
    if "\0" in text:
        raise _refusal(shown, "a binary file, expected a YAML spec")
    if not text.strip():
        raise _refusal(shown, "empty; `climbplan new climb` writes an example")
    return text
