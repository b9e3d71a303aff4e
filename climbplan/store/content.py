"""A digest of all that a plan holds, to tell whether two of them are the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath

import numpy as np


def compute_digest(value: object) -> bytes:
    """Return the BLAKE2b digest of dataclasses, arrays, containers and plain values.

    Raises TypeError for anything else: a value that is skipped could differ unnoticed.
    """
    digest = hashlib.blake2b(digest_size=32)
    for chunk in _encode(value):
        digest.update(chunk)
    return digest.digest()


def _encode(value: object) -> Iterator[bytes]:
    """Yield bytes that determine a value: its type, its extent, then what is in it."""
    yield f"{type(value).__qualname__};".encode()
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject or value.dtype.names:
            raise TypeError("arrays of objects and structured arrays have no digest")
        yield f"{value.dtype.str}{value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            yield f"{item.name}=".encode()
            yield from _encode(getattr(value, item.name))
    elif isinstance(value, (tuple, list)):
        yield f"{len(value)};".encode()
        for item in value:
            yield from _encode(item)
    elif isinstance(value, dict):
        yield f"{len(value)};".encode()
        for key, item in value.items():
            yield from _encode(key)
            yield from _encode(item)
    elif value is None or isinstance(value, (str, bool, int, float, np.generic, PurePath, Enum)):
        text = repr(value).encode()
        yield f"{len(text)};".encode() + text
    else:
        raise TypeError(f"{type(value).__name__} has no digest")
