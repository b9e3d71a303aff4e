"""A look at the text heaps of an HDF5 file before the HDF5 library sees them.

All other metadata of plan files carry checksums. The collections of variable-length text do not,
and on a damaged one the library may loop for ever or crash, which no reader could catch.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

_START = b"GCOL\x01\x00\x00\x00"  # signature, version, reserved: no text holds these bytes
_COLLECTION = struct.Struct("<8sQ")  # start, size in bytes, this header included
_OBJECT = struct.Struct("<HHIQ")  # index, references, reserved, size in bytes
_ALIGNED = 8


def text_heaps_are_whole(path: Path) -> bool:
    """Whether every text collection in the file at `path` is a chain of objects that fills it."""
    if path.stat().st_size == 0:
        return True
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_START)
        while start >= 0:
            end = _end_of(content, start)
            if end is None:
                return False
            start = content.find(_START, end)
    return True


def _end_of(content: mmap.mmap, start: int) -> int | None:
    """Where a collection ends, None if its objects do not add up."""
    if start + _COLLECTION.size > len(content):
        return None
    _, size = _COLLECTION.unpack_from(content, start)
    end = start + size
    if end > len(content):
        return None
    here = start + _COLLECTION.size
    while here + _OBJECT.size <= end:
        index, _, _, length = _OBJECT.unpack_from(content, here)
        if index == 0:  # what is left, its own header included
            return end if here + length == end else None
        here += _OBJECT.size + -(-length // _ALIGNED) * _ALIGNED
    return end if here <= end else None
