"""What goes to which stream: results to standard output, everything else to standard error."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from climbplan.errors import ClimbplanError, SpecError


@dataclass
class Session:
    """How much one invocation of the command line says."""

    quiet: bool = False
    verbose: bool = False

    def note(self, line: str) -> None:
        """A line about the run, on standard error unless quiet."""
        if not self.quiet:
            print(line, file=sys.stderr, flush=True)

    @property
    def shows_progress(self) -> bool:
        return not self.quiet and sys.stderr.isatty()


def print_result(text: str) -> None:
    """The result of a command, on standard output."""
    print(text)


def print_json(value: Any) -> None:
    """The result of a command as one JSON object; NaN and infinity are errors."""
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def print_error(error: ClimbplanError) -> None:
    """A mistake for people; those of a spec start with file and line, as editors expect."""
    text = str(error) if isinstance(error, SpecError) else f"error: {error}"
    print(text, file=sys.stderr)


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Python warnings as one line on standard error, without source code."""

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def silence_standard_output() -> None:
    """Nobody reads any more: what is still buffered must not fail again at exit."""
    sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - lives as long as the process
