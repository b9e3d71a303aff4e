"""Files that are either complete or not there: written aside, flushed to disk, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from climbplan.errors import UsageError


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """Yield a path next to `path` to write to, which takes its place if all goes well.

    Whatever stops the writing, the file at `path` stays as it was. Raises UsageError if the place
    cannot be written to.
    """
    temporary_path = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise UsageError(f"{path}: cannot be written: it is a directory")
        yield temporary_path
        _flush(temporary_path)
        os.replace(temporary_path, path)
        _flush(path.parent)  # the rename itself
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{path}: cannot be written: {reason}") from error
    finally:
        with suppress(OSError):  # a place where nothing could be written
            temporary_path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
