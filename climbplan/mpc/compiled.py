"""The one decorator of compiled functions of walking: machine code by Numba, cached on disk.

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
    for source in sorted(here.glob("compiled*.py")):
        digest.update(source.read_bytes())
    base = Path(config.CACHE_DIR) if config.CACHE_DIR else here / "__pycache__"
    return str(base / f"compiled-{digest.hexdigest()[:16]}")


def compiled(function: Function) -> Function:
    """`function` as machine code, IEEE arithmetic in the order written."""
    options: dict[str, Any] = {"cache": True, "error_model": "numpy"}
    users = config.CACHE_DIR
    try:
        config.CACHE_DIR = _directory()
        return cast(Function, numba.njit(**options)(function))
    finally:
        config.CACHE_DIR = users
