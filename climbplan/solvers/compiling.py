"""Machine code by Numba, cached on disk: the one decorator of all compiled functions.

Numba renews a function's cached code when the file of that function changes, but not when a
function that it calls does. The cache of a room therefore lies in a directory named after all
sources of its compiled functions: after an edit nothing stale is found there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba

config: Any = numba.config

Function = TypeVar("Function", bound=Callable[..., object])


class Compiler(Protocol):
    """A decorator that leaves a function's type as it is."""

    def __call__(self, function: Function, /) -> Function: ...


def compiler(room: Path, sources: str) -> Compiler:
    """The decorator of a room's functions; `sources`: glob of the room's files that have such ones.

    IEEE arithmetic in the order written, which bounds rely on. Names that begin with an underscore
    can be called from compiled functions only, which spares the time to compile a wrapper. Where
    the room's directory cannot be written to, Numba's own cache directory is used.
    """

    def compiled(function: Function) -> Function:
        options: dict[str, Any] = {
            "cache": True,
            "error_model": "numpy",  # division by zero gives infinity, as in NumPy
            "no_cfunc_wrapper": True,
            "no_cpython_wrapper": function.__name__.startswith("_"),
        }
        users = config.CACHE_DIR
        try:
            config.CACHE_DIR = _directory(room, sources)
            return cast(Function, numba.njit(**options)(function))
        finally:
            config.CACHE_DIR = users

    return compiled


@cache
def _directory(room: Path, sources: str) -> str:
    """Beside the room's byte code, or below the user's own NUMBA_CACHE_DIR."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in (Path(__file__), *sorted(room.glob(sources))):
        digest.update(source.read_bytes())
    base = Path(config.CACHE_DIR) if config.CACHE_DIR else room / "__pycache__"
    return str(base / f"compiled-{digest.hexdigest()[:16]}")
