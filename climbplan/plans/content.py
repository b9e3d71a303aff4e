"""A digest of all that a plan holds, to tell whether two of them are the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath

import numpy as np


def digest_of(value: object) -> bytes:
    """The BLAKE2b digest of dataclasses, arrays, containers and plain values, bit for bit.

    Raises TypeError for anything else: what is not looked at could differ.
    """
    digest = hashlib.blake2b(digest_size=32)
    for part in _parts(value):
        digest.update(part)
    return digest.digest()


def _parts(value: object) -> Iterator[bytes]:
    """Bytes that determine a value: its type, its extent, then what is in it."""
    yield f"{type(value).__qualname__};".encode()
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("arrays of objects have no digest")
        yield f"{value.dtype.str}{value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value) and not isinstance(value, type):
        for one in fields(value):
            yield f"{one.name}=".encode()
            yield from _parts(getattr(value, one.name))
    elif isinstance(value, (tuple, list)):
        yield f"{len(value)};".encode()
        for item in value:
            yield from _parts(item)
    elif isinstance(value, dict):
        yield f"{len(value)};".encode()
        for key, item in value.items():
            yield from _parts(key)
            yield from _parts(item)
    elif value is None or isinstance(value, (str, bool, int, float, np.generic, PurePath, Enum)):
        text = repr(value).encode()
        yield f"{len(text)};".encode() + text
    else:
        raise TypeError(f"{type(value).__name__} has no digest")
