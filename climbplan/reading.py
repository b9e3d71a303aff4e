"""Read files from elsewhere: bounded before anything is allocated, and refused in plain words.

A few kilobytes can claim or expand to terabytes, and libraries fail on damaged files in many ways.
`read_bytes` and `read_text` take at most a stated number of bytes, of devices without an end too.
`reading` surrounds a parser: it bounds the memory of the block and turns whatever a damaged file
can raise into one error that says what was expected.
"""

from __future__ import annotations

import csv
import struct
import tokenize
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from climbplan.errors import ClimbplanError, UsageError

MAX_MEMORY = 3 * 2**29  # [bytes] that a parser may allocate, in addition to what is there already

# What the standard library and NumPy raise when bytes are not what they claim to be
DAMAGE: tuple[type[Exception], ...] = (
    ValueError,
    OverflowError,
    RecursionError,
    SyntaxError,
    EOFError,
    tokenize.TokenError,
    csv.Error,
    struct.error,
    zlib.error,
)
ANY_ERROR: tuple[type[Exception], ...] = (Exception,)


def read_bytes(path: Path, max_bytes: int, expected: str) -> bytes:
    """Return the content of a file, or raise UsageError if there is none or it is too large.

    Args:
        path: file, pipe or device; of one without an end `max_bytes` + 1 bytes are read.
        max_bytes: largest size that is accepted.
        expected: what the file should be, for messages: "a CSV file of grips".
    """
    with reading(path, expected), path.open("rb") as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise UsageError(
            f"{path}: larger than {max_bytes / 1e6:g} MB, expected {expected} of at most that"
        )
    return content


def read_text(path: Path, max_bytes: int, expected: str) -> str:
    """Return the content of a UTF-8 file, as `read_bytes`; a byte order mark is left out."""
    try:
        return read_bytes(path, max_bytes, expected).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        message = f"{path}: cannot be read: not UTF-8 text, expected {expected}"
        raise UsageError(message) from error


@contextmanager
def reading(
    source: Path | str,
    expected: str,
    refuse: type[ClimbplanError] = UsageError,
    damage: tuple[type[Exception], ...] = DAMAGE,
) -> Iterator[None]:
    """Turn what a file from elsewhere can raise in the block into one error with exit code 2.

    Args:
        source: file, as messages name it.
        expected: what it should be: "a NumPy array of numbers".
        refuse: class of the error that is raised.
        damage: exceptions that say that the file is damaged; `ANY_ERROR` for libraries that raise
            anything, none where the block does more than to read.
    """
    try:
        with bounded_memory():
            yield
    except ClimbplanError:
        raise
    except MemoryError as error:
        limit = f"more than {MAX_MEMORY / 2**30:g} GiB of memory"
        raise refuse(f"{source}: needs {limit}, expected {expected} that needs less") from error
    except OSError as error:
        reason = error.strerror or first_line(error)
        raise refuse(f"{source}: cannot be read: {reason}, expected {expected}") from error
    except damage as error:
        raise refuse(f"{source}: not {expected} ({first_line(error)})") from error


def first_line(error: Exception) -> str:
    """Return the start of an error's first line; of one without words the name of its class."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    lines = str(error).splitlines() or [""]
    return lines[0][:200] or type(error).__name__


@contextmanager
def bounded_memory(max_bytes: int = MAX_MEMORY) -> Iterator[None]:
    """Have allocations fail with MemoryError beyond `max_bytes` more than the process has now.

    On systems without such a limit (of the address space, as Linux has it) nothing is bounded.
    """
    try:
        import resource

        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError):
        yield
        return
    limits = [
        size + max_bytes,
        *(memory_limit for memory_limit in (soft, hard) if memory_limit != resource.RLIM_INFINITY),
    ]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
