"""Compile functions with Numba, cached on disk, by one decorator for the whole package.

Numba renews a function's cached code when the file of that function changes, but not when a
function that it calls does. The cache of a folder therefore lies in a directory named after the
hash of all sources of its compiled functions, and of the sources of generated code. After an edit
no outdated code is found there.

A machine compiles once, for up to a minute. The package's log has a line then, which the command
line shows. The progress of the run names the function that is being compiled.
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

from climbplan.progress import report_compilation

config: Any = numba.config

_TESTED_VERSION = (0, 68)  # last version of Numba with which internals were tested
LONG = 1.0  # compilation time from which a line is logged [s]
_MESSAGE = "compiling functions, which a machine does once; this takes up to a minute"
_log = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., object])


class Compiler(Protocol):
    """A decorator that preserves a function's type."""

    def __call__(self, function: Function, /) -> Function: ...


def create_compiler(
    folder: Path,
    sources: str | tuple[str, ...],
    generated_from: bytes = b"",
    *,
    borrows_references: bool = False,
    releases_gil: bool = False,
) -> Compiler:
    """Create the decorator of a folder's compiled functions.

    Arithmetic is IEEE in the order written, on which bounds rely. Functions whose names begin with
    an underscore can be called from compiled functions only and are compiled together with these
    (`joined_code`), which halves the time for a tree of calls. An array assigned to a slice of
    another costs seconds of compilation; a loop does not.

    Code that a wheel carries is taken first (`precompiled`). Other code is stored in the first
    writable of these: the user's NUMBA_CACHE_DIR, the folder's byte-code directory, the user's
    cache directory. Without any, each process compiles.

    Args:
        folder: Folder of the functions.
        sources: Globs of its files that have compiled functions, or constants of these.
        generated_from: Hash of `generated.hash_sources`, for statements elsewhere that they call.
        borrows_references: Whether functions with a leading underscore neither allocate nor return
            arrays.
            Reference counts of their arguments, which are atomic and slow, are then omitted.
        releases_gil: Whether functions release the GIL, so that other threads can stop them.
    """

    def compiled(function: Function) -> Function:
        name = _name_directory(folder, sources, generated_from)
        place = _select_directory(folder, name)
        is_inner = function.__name__.startswith("_")
        inner, outer = select_pipelines(numba.version_info.short)
        options: dict[str, Any] = {
            "cache": place is not None,
            "error_model": "numpy",  # division by zero gives infinity, as in NumPy
            "no_cfunc_wrapper": True,
            "nogil": releases_gil,
            "no_cpython_wrapper": is_inner,
            "pipeline_class": inner if is_inner else outer,
        }
        if borrows_references and is_inner:
            options["_nrt"] = False
        users = config.CACHE_DIR
        try:
            config.CACHE_DIR = place or ""
            dispatcher = numba.njit(**options)(function)
        finally:
            config.CACHE_DIR = users
        # Code of inner functions is part of that of their callers; NUMBA_DISABLE_JIT has none
        has_machine_code = not is_inner and not config.DISABLE_JIT
        if has_machine_code and numba.version_info.short <= _TESTED_VERSION:
            from climbplan.precompiled import attach_carried_code

            attach_carried_code(dispatcher, name)
        return cast("Function", dispatcher)

    return compiled


@cache
def select_pipelines(version: tuple[int, int]) -> tuple[type[Any], type[Any]]:
    """Return Numba's passes for functions that only compiled ones call, and for all others.

    Versions later than those with which `joined_code` was tested use Numba's default for both,
    since `joined_code` builds on internals. Results are the same, and compilation takes twice the
    time.
    """
    if version > _TESTED_VERSION:
        return numbas_own.Compiler, numbas_own.Compiler
    from climbplan.joined_code import INNER, OUTER

    return INNER, OUTER


@cache
def _name_directory(folder: Path, sources: str | tuple[str, ...], generated_from: bytes) -> str:
    """Return the name of the directory of a folder's compiled code, by a hash of its sources."""
    digest = hashlib.sha256(numba.__version__.encode() + generated_from)
    globs = (sources,) if isinstance(sources, str) else sources
    compiler_files = (Path(__file__), Path(__file__).with_name("joined_code.py"))
    for source in (*compiler_files, *sorted(file for glob in globs for file in folder.glob(glob))):
        digest.update(source.read_bytes())
    return f"compiled-{digest.hexdigest()[:16]}"


@cache
def _select_directory(folder: Path, name: str) -> str | None:
    """Return the directory of a folder's compiled code, None if none is writable."""
    bases = [Path(config.CACHE_DIR)] if config.CACHE_DIR else []
    bases += [folder / "__pycache__", *_list_user_caches()]
    return next((str(base / name) for base in bases if _is_writable(base / name)), None)


def _list_user_caches() -> list[Path]:
    """Return the user's cache directory by the XDG base directory specification."""
    xdg_cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if xdg_cache.is_absolute():  # relative ones are to be ignored
        return [xdg_cache / "climbplan"]
    try:
        return [Path.home() / ".cache" / "climbplan"]
    except RuntimeError:  # a user without a home
        return []


def _is_writable(place: Path) -> bool:
    """Return whether files can be created in a directory."""
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            return True
    except OSError:
        return False


class _CompilationListener(event.Listener):  # type: ignore[misc]  # Numba has no types
    """Reports what is compiled, and logs a line once this process has compiled for long.

    Numba's cache causes no event.
    """

    def __init__(self) -> None:
        self.depth = 0  # a function's compilation starts those of what it calls
        self.start_time = self.total_time = 0.0
        self.has_logged = False

    def on_start(self, compilation: Any) -> None:
        if self.depth == 0:
            self.start_time = time.perf_counter()
            function = compilation.data["dispatcher"].py_func
            report_compilation(f"{function.__module__}.{function.__name__}")
        self.depth += 1
        self._log_if_long()

    def on_end(self, _: object) -> None:
        self._log_if_long()
        self.depth = max(self.depth - 1, 0)
        if self.depth == 0:
            self.total_time += time.perf_counter() - self.start_time
            report_compilation("")

    def _log_if_long(self) -> None:
        """Log the line if compilation has taken long."""
        if not self.has_logged and self.total_time + time.perf_counter() - self.start_time > LONG:
            self.has_logged = True
            _log.info(_MESSAGE, extra={"note": True})


_TELLER = _CompilationListener()
event.register("numba:compile", _TELLER)
