"""Machine code by Numba, cached on disk: the one decorator of all compiled functions.

Numba renews a function's cached code when the file of that function changes, but not when a
function that it calls does. The cache of a room therefore lies in a directory named after all
sources of its compiled functions, and of what they are generated from: after an edit nothing stale
is found there.

A machine compiles once, for up to a minute. The package's log has a line then, which the
command line shows; nothing is said where the cache serves.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
from numba.core import compiler as numbas_own
from numba.core import event

config: Any = numba.config

_JOINED = (0, 68)  # the last version of Numba whose inner parts `joined_code` was tried with
LONG = 1.0  # [s] of compilation that is worth a word
_WORD = "compiling functions, which a machine does once; this takes up to a minute"
_log = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., object])


class Compiler(Protocol):
    """A decorator that leaves a function's type as it is."""

    def __call__(self, function: Function, /) -> Function: ...


def compiler(
    room: Path,
    sources: str | tuple[str, ...],
    generated_from: bytes = b"",
    *,
    borrows: bool = False,
    lets_go: bool = False,
) -> Compiler:
    """The decorator of a room's functions.

    sources: globs of the room's files that have such ones, or that these take numbers from.

    borrows: functions whose names begin with an underscore make no arrays and return none, and so
    need not count references to those that they are given, nor to rows of them: atomic additions
    that in functions of small vectors take more time than all else.

    lets_go: functions let go of Python while they run, so that other threads can stop them.

    generated_from: as of `generated.generated_from`, of statements elsewhere that they call.

    IEEE arithmetic in the order written, which bounds rely on. Names that begin with an underscore
    can be called from compiled functions only, and become machine code with these (`joined_code`):
    a tree of calls compiles in half of the time. An array that is assigned to a part of another
    takes 2 s, once a process, for Numba's words on shapes that differ; a loop does not.

    Code is kept in the first of these that can be written to: the user's NUMBA_CACHE_DIR, beside
    the room's byte code, the user's cache directory; where none can, each process compiles.
    """

    def compiled(function: Function) -> Function:
        place = _directory(room, sources, generated_from)
        inner, outer = pipelines(numba.version_info.short)
        options: dict[str, Any] = {
            "cache": place is not None,
            "error_model": "numpy",  # division by zero gives infinity, as in NumPy
            "no_cfunc_wrapper": True,
            "nogil": lets_go,
            "no_cpython_wrapper": function.__name__.startswith("_"),
            "pipeline_class": inner if function.__name__.startswith("_") else outer,
        }
        if borrows and function.__name__.startswith("_"):
            options["_nrt"] = False
        users = config.CACHE_DIR
        try:
            config.CACHE_DIR = place or ""
            return cast("Function", numba.njit(**options)(function))
        finally:
            config.CACHE_DIR = users

    return compiled


@cache
def pipelines(version: tuple[int, int]) -> tuple[type[Any], type[Any]]:
    """Numba's passes over functions that only compiled ones call, and over all others.

    Numba's own, for both, with versions later than those that `joined_code` was tried with, as it
    builds on what these do not promise: the same results, compiled in twice the time.
    """
    if version > _JOINED:
        return numbas_own.Compiler, numbas_own.Compiler
    from climbplan.solvers.joined_code import INNER, OUTER

    return INNER, OUTER


@cache
def _directory(room: Path, sources: str | tuple[str, ...], generated_from: bytes) -> str | None:
    """Where the code of a room is kept, None if nowhere."""
    digest = hashlib.sha256(numba.__version__.encode() + generated_from)
    globs = (sources,) if isinstance(sources, str) else sources
    own = (Path(__file__), Path(__file__).with_name("joined_code.py"))
    for source in (*own, *sorted(file for glob in globs for file in room.glob(glob))):
        digest.update(source.read_bytes())
    name = f"compiled-{digest.hexdigest()[:16]}"
    bases = [Path(config.CACHE_DIR)] if config.CACHE_DIR else []
    bases += [room / "__pycache__", *_users_own()]
    return next((str(base / name) for base in bases if _can_be_written(base / name)), None)


def _users_own() -> list[Path]:
    """The user's cache directory, as the XDG base directory specification has it."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():  # relative ones are to be ignored
        return [named / "climbplan"]
    try:
        return [Path.home() / ".cache" / "climbplan"]
    except RuntimeError:  # a user without a home
        return []


def _can_be_written(place: Path) -> bool:
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            return True
    except OSError:
        return False


class _Told(event.Listener):  # type: ignore[misc]  # Numba has no types
    """A line in the log once this process has compiled for long; Numba's cache causes no event."""

    def __init__(self) -> None:
        self.depth = 0  # a function's compilation starts those of what it calls
        self.begun = self.spent = 0.0
        self.told = False

    def on_start(self, _: object) -> None:
        if self.depth == 0:
            self.begun = time.perf_counter()
        self.depth += 1
        self._look()

    def on_end(self, _: object) -> None:
        self._look()
        self.depth = max(self.depth - 1, 0)
        if self.depth == 0:
            self.spent += time.perf_counter() - self.begun

    def _look(self) -> None:
        if not self.told and self.spent + time.perf_counter() - self.begun > LONG:
            self.told = True
            _log.info(_WORD, extra={"note": True})


_TELLER = _Told()
event.register("numba:compile", _TELLER)
