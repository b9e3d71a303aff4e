"""What goes to which stream: results to standard output, everything else to standard error."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from climbplan.errors import ClimbplanError, SpecError, UsageError

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")  # all but tabs and ends of lines
_NOT_PLAIN = re.compile(r"[\x7f-\x9f\ud800-\udfff]")  # that JSON may hold as they are


@dataclass
class Invocation:
    """How much one invocation of the command line says."""

    quiet: bool = False
    verbose: bool = False
    as_json: bool = False  # standard output carries one JSON object, however the run ends
    stage: str = ""  # the last one that was begun
    error: BaseException | None = None  # what ended the run
    answer: dict[str, Any] | None = None  # what `print_json` was given, printed when the run ends

    def note(self, line: str) -> None:
        """A line about the run, on standard error unless quiet."""
        if not self.quiet:
            say(line)

    @property
    def shows_progress(self) -> bool:
        """Return whether a bar of progress moves on the terminal that standard error is."""
        return not self.quiet and sys.stderr.isatty()

    @property
    def writes_progress(self) -> bool:
        """Return whether lines of progress go to a standard error that is no terminal."""
        return not self.quiet and not sys.stderr.isatty()

    def write_progress(self, line: str) -> None:
        """Write a line of progress, on standard error, in the columns of other stages."""
        say(f"{'progress':<9} {line}")


_RUNNING: ContextVar[Invocation | None] = ContextVar("running", default=None)


def harmless(text: str) -> str:
    """Text with control characters written out: names and reasons in files from elsewhere must not
    drive a terminal."""
    return _CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


def say(text: str) -> None:
    """Print a line for people on standard error; where that cannot be written nobody reads it."""
    with suppress(OSError):
        print(harmless(text), file=sys.stderr, flush=True)


def print_result(text: str) -> None:
    """The result of a command, on standard output."""
    with standard_output() as stream:
        print(harmless(text), file=stream)


def print_json(value: Mapping[str, Any]) -> None:
    """The result of a command as one JSON object; NaN and infinity are errors.

    With `--json` it is kept until the run has ended, when its exit code joins it.
    """
    session = _RUNNING.get()
    if session is None or not session.as_json:
        _print_object(value)
        return
    session.answer = {**(session.answer or {}), **value}


def print_answer(session: Invocation, code: int, failure: Mapping[str, Any]) -> None:
    """Print the one object of a run with `--json`, at its end.

    Args:
        session: the run, with its result if there is one.
        code: exit code of the run.
        failure: fields that describe a failure; they are added to the result.
    """
    if code == 0 and session.answer is None:
        return  # help and the like, which are for people
    answer = session.answer or {}
    _print_object({**failure, **answer, "exit_code": code} if code else {**answer, "exit_code": 0})


def _print_object(value: Mapping[str, Any]) -> None:
    # What would drive a terminal or cannot be encoded, as JSON writes it
    ascii_only = not (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    text = json.dumps(value, indent=2, ensure_ascii=ascii_only, allow_nan=False)
    print_result(_NOT_PLAIN.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


@contextmanager
def running(session: Invocation) -> Iterator[None]:
    """While the command line of this session runs."""
    token = _RUNNING.set(session)
    try:
        yield
    finally:
        _RUNNING.reset(token)


@contextmanager
def standard_output() -> Iterator[TextIO]:
    """Standard output, flushed at the end.

    Raises:
        UsageError: it cannot be written (a full disk). A reader that left is a BrokenPipeError.
    """
    try:
        yield sys.stdout
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        silence_standard_output()
        raise UsageError(f"standard output cannot be written: {error.strerror}") from error


def print_error(error: ClimbplanError) -> None:
    """A mistake for people; those of a spec start with file and line, as editors expect."""
    text = str(error) if isinstance(error, SpecError) else f"error: {error}"
    say(text)


def warn(message: str) -> None:
    """Something that a person should know although the run goes on; quiet does not hide it."""
    say(f"warning: {message}")


class _LogLines(logging.Handler):
    """The package's log as plain lines: warnings always, notes unless quiet, the rest with -v."""

    def __init__(self, session: Invocation) -> None:
        super().__init__()
        self._session = session
        self._said: set[str] = set()  # of several tries of a planner, each says it again

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if record.levelno >= logging.WARNING:
            if message not in self._said:
                self._said.add(message)
                warn(message)
        elif getattr(record, "note", False):  # about the run, as those of commands
            self._session.note(record.getMessage())
        elif self._session.verbose:
            say(message)


@contextmanager
def plain_messages(session: Invocation) -> Iterator[None]:
    """Warnings and log messages as single lines on standard error, without source code."""

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        warn(str(message))

    logger, lines = logging.getLogger("climbplan"), _LogLines(session)
    level = logger.level
    # Of fonts that it looks through on a first run, and of a home that it cannot write to
    figures = logging.getLogger("matplotlib")
    figures_level = figures.level
    figures.setLevel(logging.ERROR)
    logger.addHandler(lines)
    logger.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield
    finally:
        logger.removeHandler(lines)
        logger.setLevel(level)
        figures.setLevel(figures_level)


def prepare_streams() -> None:
    """Open what the shell closed (`>&-`), and write out characters that an encoding lacks."""
    if sys.stdout is None:
        silence_standard_output()
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115 - lives as long as the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def silence_standard_output() -> None:
    """Nobody reads any more: what is still buffered must not fail again at exit."""
    sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - lives as long as the process
