"""The one decorator of compiled functions: machine code by Numba, kept in a cache on disk.

Numba renews a function's cached code when the file of that function changes, but not when a
function that it calls does. The cache therefore lies in a directory named after all sources of
compiled functions: after an edit nothing stale is found there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

config: Any = numba.config

Function = TypeVar("Function", bound=Callable[..., object])


@cache
def _directory() -> str:
    """Beside the byte code, or below the user's own NUMBA_CACHE_DIR."""
    here = Path(__file__).parent
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(here.glob("exact_*.py")):
        digest.update(source.read_bytes())
    base = Path(config.CACHE_DIR) if config.CACHE_DIR else here / "__pycache__"
    return str(base / f"compiled-{digest.hexdigest()[:16]}")


def compiled(function: Function) -> Function:
    """`function` as machine code; IEEE arithmetic in the order written, which bounds rely on.

    Names that begin with an underscore can be called from compiled functions only, which spares the
    time to compile a wrapper. Where the package's directory cannot be written to, Numba's own cache
    directory is used.
    """
    options: dict[str, Any] = {
        "cache": True,
        "error_model": "numpy",  # division by zero gives infinity, as in NumPy
        "no_cfunc_wrapper": True,
        "no_cpython_wrapper": function.__name__.startswith("_"),
    }
    users = config.CACHE_DIR
    try:
        config.CACHE_DIR = _directory()
        return cast(Function, numba.njit(**options)(function))
    finally:
        config.CACHE_DIR = users
