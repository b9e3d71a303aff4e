"""What `--json` prints of a run that failed: one object, the same fields whatever the command."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import signal
from typing import Any

from climbplan.errors import (
    Conflict,
    ExitCode,
    NoPlanFound,
    NotProved,
    Remedy,
    SpecError,
    UsageError,
)

INTERRUPTED = 128 + signal.SIGINT  # as shells report it
TERMINATED = 128 + signal.SIGTERM
PIPE_CLOSED = 128 + signal.SIGPIPE

# Where no exception says more: by exit code, what `status` and `message` hold
_MEANINGS: dict[int, tuple[str, str]] = {
    ExitCode.INTERNAL: ("error", "internal error"),
    ExitCode.USAGE: ("usage", "the command cannot be carried out as given"),
    ExitCode.INFEASIBLE: ("infeasible", "every problem asked for is proved infeasible"),
    ExitCode.LIMIT: ("limit", "a limit was reached first, for one problem or more"),
    ExitCode.UNVERIFIED: (
        "unverified",
        "a plan was found, but it fails its check or its data are implausible",
    ),
    INTERRUPTED: ("interrupted", "interrupted"),
    TERMINATED: ("interrupted", "terminated"),
    128 + signal.SIGHUP: ("interrupted", "hung up"),
}


def failure_fields(error: BaseException | None, code: int, stage: str) -> dict[str, Any]:
    """`status`, `stage`, `message`, `conflict` and `remedies` of a failure, JSON-ready.

    error: what ended the run, None if only the exit code tells. stage: the last one that was begun,
    for errors that do not say where they happened. A refused spec also has `mistakes`, a refusal
    that proves nothing what it is `because` of.
    """
    status, message = _MEANINGS.get(code, ("error", ""))
    conflicts: list[Conflict] = []
    remedies: tuple[Remedy, ...] = ()
    own: dict[str, Any] = {}
    if error is not None:
        message = _words(error, code) or message
    if isinstance(error, NoPlanFound):
        status, message = error.status, error.message
        stage = error.stage or stage or "plan"
        conflicts, remedies = error.conflicts, error.remedies
        if isinstance(error, NotProved):
            own["because"] = error.because
    elif hasattr(error, "format_message"):
        stage = "arguments"
    elif isinstance(error, SpecError):
        stage = "spec"
        own["mistakes"] = [dataclasses.asdict(mistake) for mistake in error.mistakes]
    return {
        "status": status,
        "stage": stage,
        "message": message,
        "conflict": [
            {
                "where": conflict.where,
                "constraints": list(conflict.constraints),
                "names": list(conflict.names),
                "remedies": [_plain(remedy) for remedy in conflict.remedies],
            }
            for conflict in conflicts
        ],
        "remedies": [_plain(remedy) for remedy in remedies],
        **own,
    }


# Of files and disks: no bug of ours, wherever it comes up
_SURROUNDINGS = (
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO,
    errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EMFILE, errno.ENFILE,
    errno.ESTALE, errno.ETXTBSY, errno.EBUSY,
)  # fmt: skip


def fault_of_surroundings(error: BaseException) -> UsageError | None:
    """Return what to say of a file, a disk or a directory that fails; None for any other error.

    Readers and writers say it with what they expected. This is for all others, such as a question
    whether a path is there whose name is too long.
    """
    if not isinstance(error, OSError):
        return None
    if isinstance(error, FileNotFoundError) and not _has_directory():
        return UsageError("the current directory was deleted; change to one that exists")
    if error.errno not in _SURROUNDINGS:
        return None
    where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    return UsageError(f"{where}cannot be used: {error.strerror}; expected another path or disk")


def _has_directory() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _words(error: BaseException, code: int) -> str:
    """What is said of an error; mistakes of the command line know which option they are about."""
    if code == ExitCode.INTERNAL:
        return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
    format_message = getattr(error, "format_message", None)
    return str(error if format_message is None else format_message())


def _plain(remedy: Remedy) -> dict[str, Any]:
    """A remedy whose value JSON can hold; without an end it helps nobody as a number."""
    found = remedy.as_dict()
    value = found["value"]
    if isinstance(value, float) and not math.isfinite(value):
        found["value"] = None
    return found
