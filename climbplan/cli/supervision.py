"""A small process above the one that computes, so that a command ends soon after a signal.

A signal interrupts Python, not compiled code: a factorisation, a presolve or a compiler may run for
many seconds before Python is asked again, and no exception can be raised until then. The command
therefore runs in a process below this one, which passes signals on and waits. One that is not gone
after `GRACE` is killed, and what it left half-written is removed here. So is what a process
leaves that a crash in compiled code, or the system for want of memory, has ended.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

GRACE = 1.4  # [s] from a signal; with all that follows a run ends within 2 s
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}
_DIE_WITH_PARENT, _ADOPT_ORPHANS = 1, 36  # prctl's PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER
_WHOLE, _IF_EMPTY, _TOLD, _ANSWERED = b"+", b"-", b"!", b"="  # how entries of the ledger begin
_ledger: int | None = None  # file of what is to be done if this process does not come to it


def remove_if_killed(path: Path, whole: bool = True) -> None:
    """Have a directory that this process is about to make removed if the process is killed.

    whole: with all that is in it; else only if it is empty by then.
    """
    if _ledger is not None:
        os.write(_ledger, (_WHOLE if whole else _IF_EMPTY) + os.fsencode(path.absolute()) + b"\0")


def end_is_told() -> None:
    """This process has said how it ends: killed after that, nobody says it again."""
    if _ledger is not None:
        os.write(_ledger, _TOLD + b"\0")


def answer_is_printed() -> None:
    """Standard output has what `--json` prints of this run."""
    if _ledger is not None:
        os.write(_ledger, _ANSWERED + b"\0")


def run_supervised(
    command: Callable[[], int], unanswered: Callable[[int, str], None] = lambda code, words: None
) -> int:
    """Run a command in a child process and return the exit code.

    That of the command, or 128 and the signal's number for one that was killed; `unanswered` is
    then called with it and with words, unless the process had printed its answer.
    """
    global _ledger
    if sys.platform != "linux":
        return command()
    passed_on = {
        number for number in _WORDS if signal.getsignal(number) != signal.SIG_IGN
    }  # those that are ignored (nohup, background jobs) stay so
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*passed_on, signal.SIGCHLD})
    ledger = _new_ledger()
    _prctl(_ADOPT_ORPHANS, 1)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _prctl(_DIE_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(128 + signal.SIGKILL)
        _ledger = ledger
        return _run_in_child(command, before)
    received, status = _wait(child, passed_on)
    if os.WIFSIGNALED(status):
        _end_orphans()
        number = received if received is not None else os.WTERMSIG(status)
        message, notes = _last_word(number, received), _clear_away(ledger)
        with suppress(OSError):  # a terminal that is gone
            if _TOLD not in notes:
                os.write(2, f"{message}\n".encode())
            if _ANSWERED not in notes:
                unanswered(128 + number, message)
        return 128 + number
    return os.WEXITSTATUS(status)


def _run_in_child(command: Callable[[], int], mask: set[int]) -> int:
    """Run the command in the child process, with signal handlers installed first."""
    from climbplan.cli.interrupts import raise_on_signals

    raise_on_signals()
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    return command()


def _wait(child: int, passed_on: set[signal.Signals]) -> tuple[int | None, int]:
    """The first signal that came, and how the child ended, as `waitpid` says."""
    received: int | None = None
    until = float("inf")
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return received, status
        left = min(until - time.monotonic(), 3600.0)
        if left <= 0:
            os.kill(child, signal.SIGKILL)
            return received, os.waitpid(child, 0)[1]
        came = signal.sigtimedwait({*passed_on, signal.SIGCHLD}, left)
        if came is None or came.si_signo == signal.SIGCHLD:
            continue
        # From a terminal it has reached the child too, which heeds the first one only.
        os.kill(child, came.si_signo)
        if received is None:
            received, until = came.si_signo, time.monotonic() + GRACE


def _last_word(number: int, received: int | None) -> str:
    if received is not None:
        return _WORDS[signal.Signals(received)]
    name = signal.Signals(number).name
    if number == signal.SIGKILL:
        return f"killed ({name}), perhaps because memory ran out; nothing was written"
    return f"internal error: the process crashed ({name}); nothing was written"


def _end_orphans() -> None:
    """Workers and solvers that the killed process had started; they have become children here."""
    while True:
        try:
            listed = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        except OSError:
            return  # a kernel without such lists
        if not listed:
            return
        for pid in map(int, listed):
            os.kill(pid, signal.SIGKILL)
        for pid in map(int, listed):
            os.waitpid(pid, 0)


def _new_ledger() -> int:
    """A file in memory, beyond the three that a program's streams have."""
    first = os.memfd_create("climbplan")
    try:
        return fcntl.fcntl(first, fcntl.F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(first)


def _clear_away(ledger: int) -> list[bytes]:
    """Remove what the ledger lists; its entries."""
    with os.fdopen(ledger, "rb") as file:
        file.seek(0)
        entries = [entry for entry in file.read().split(b"\0") if entry]
    for entry in reversed(entries):  # what was made last goes first
        path = Path(os.fsdecode(entry[1:]))
        if entry.startswith(_WHOLE):
            shutil.rmtree(path, ignore_errors=True)
        elif entry.startswith(_IF_EMPTY):
            with suppress(OSError):  # in use by others
                path.rmdir()
    return entries


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)
