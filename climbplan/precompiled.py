"""Machine code that a wheel carries, so that the first run on a machine compiles nothing.

Numba's cache holds code for one processor and names it by the time of the source file. A wheel
serves many machines: its code is named by a hash of the sources instead (`compiling`) and is made
for a level of the architecture that processors of the last ten years have. A machine below that
level, another version of Numba, of Python or of the sources, or argument types that the wheel's
code does not have are compiled as ever. So are all functions with a version of Numba later than
those whose internals this module was tested with.
"""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba.core import caching

config: Any = numba.config

CARRIED = Path(__file__).with_name("machine_code")  # in a wheel only
DESTINATION = "CLIMBPLAN_PRECOMPILE_DIR"  # directory that a build stores code in
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")
LEVEL = "x86-64-v3" if _IS_X86 else "generic"  # LLVM's name of the processors
_FEATURES = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2")

if DESTINATION in os.environ:  # Numba generates code for the level instead of this processor
    config.CPU_NAME, config.CPU_FEATURES = LEVEL, ""


class _Locator(caching._CacheLocator):  # type: ignore[misc]  # Numba has no types
    """Names a function by its line; the directory says which sources the code is from."""

    def __init__(self, function: Any) -> None:
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, _: str) -> _Locator:
        return cls(function)

    def ensure_cache_path(self) -> None:
        """Do nothing: `_CarriedCode` has created it."""

    def get_cache_path(self) -> str:
        return ""

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Serialiser(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _CarriedCode(caching.FunctionCache):  # type: ignore[misc]
    """Cache of a function's code in a wheel; what it lacks is in Numba's own cache."""

    _impl_class = _Serialiser

    def __init__(self, dispatcher: Any, directory: Path, stores: bool) -> None:
        super().__init__(dispatcher.py_func)
        self._local_cache, self._stores = dispatcher._cache, stores
        self._cache_file = caching.IndexDataCacheFile(
            str(directory), self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    @property
    def cache_path(self) -> Any:
        return self._local_cache.cache_path

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        carried = super().load_overload(signature, target_context)
        if carried is None and not self._stores:
            return self._local_cache.load_overload(signature, target_context)
        return carried

    def save_overload(self, signature: Any, compilation: Any) -> None:
        if self._stores:
            super().save_overload(signature, compilation)
        else:
            self._local_cache.save_overload(signature, compilation)

    def flush(self) -> None:
        self._local_cache.flush()

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        _, _, hashes = super()._index_key(signature, codegen)
        return signature, (codegen.magic_tuple()[0], LEVEL), hashes


def attach_carried_code(dispatcher: Any, sources: str) -> None:
    """Let a compiled function take its code from the wheel, or store it there in a build.

    Args:
        dispatcher: Numba's function.
        sources: Name of the directory of code from the same sources.
    """
    if destination := os.environ.get(DESTINATION):
        directory = Path(destination) / sources
        directory.mkdir(parents=True, exist_ok=True)
        dispatcher._cache = _CarriedCode(dispatcher, directory, stores=True)
    elif (CARRIED / sources).is_dir() and _is_supported():
        dispatcher._cache = _CarriedCode(dispatcher, CARRIED / sources, stores=False)


def _is_supported() -> bool:
    """Return whether this processor runs code of the level."""
    features = binding.get_host_cpu_features()
    return not _IS_X86 or all(features.get(feature) for feature in _FEATURES)
