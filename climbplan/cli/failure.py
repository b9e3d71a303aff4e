"""What `--json` prints of a run that failed: one object, the same fields whatever the command."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import signal
from pathlib import Path
from typing import Any

from climbplan.errors import (
    Conflict,
    ExitCode,
    NoPlanFound,
    Remedy,
    SpecError,
    Unresolved,
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
    """Return `status`, `stage`, `message`, `conflict` and `remedies` of a failure for JSON.

    Specs with mistakes also have `mistakes`; failures that prove nothing have their `because`, and
    where part of the way was planned, `partial` is the path of that plan.

    Args:
        error: the exception that ended the run; None if only the exit code is known.
        code: exit code of the run.
        stage: the last stage that began, for errors without a stage of their own.
    """
    status, message = _MEANINGS.get(code, ("error", ""))
    conflicts: list[Conflict] = []
    remedies: tuple[Remedy, ...] = ()
    details: dict[str, Any] = {}
    if error is not None:
        message = _format_error(error, code) or message
    if isinstance(error, NoPlanFound):
        status, message = error.status, error.message
        stage = error.stage or stage or "plan"
        conflicts, remedies = error.conflicts, error.remedies
        if isinstance(error, Unresolved):
            details["because"] = error.because
        if isinstance(error.partial, Path):
            details["partial"] = str(error.partial)
    elif hasattr(error, "format_message"):
        stage = "arguments"
    elif isinstance(error, SpecError):
        stage = "spec"
        details["mistakes"] = [dataclasses.asdict(mistake) for mistake in error.mistakes]
    return {
        "status": status,
        "stage": stage,
        "message": message,
        "conflict": [
            {
                "where": conflict.where,
                "constraints": list(conflict.constraints),
                "names": list(conflict.names),
                "remedies": [_convert_remedy(remedy) for remedy in conflict.remedies],
            }
            for conflict in conflicts
        ],
        "remedies": [_convert_remedy(remedy) for remedy in remedies],
        **details,
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


def _format_error(error: BaseException, code: int) -> str:
    """Format the message of an error; mistakes of the command line name their option."""
    if code == ExitCode.INTERNAL:
        return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
    format_message = getattr(error, "format_message", None)
    return str(error if format_message is None else format_message())


def _convert_remedy(remedy: Remedy) -> dict[str, Any]:
    """Convert a remedy to plain values; JSON has no infinite numbers, so they become null."""
    fields = remedy.as_dict()
    value = fields["value"]
    if isinstance(value, float) and not math.isfinite(value):
        fields["value"] = None
    return fields
