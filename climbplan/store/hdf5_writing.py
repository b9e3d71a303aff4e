"""Writing HDF5: plain numbers, booleans and UTF-8 text, each dataset with `units` and `frame`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from climbplan.store.atomic_file import replace_atomically
from climbplan.store.hdf5_layout import DatasetLayout

_TEXT = h5py.string_dtype("utf-8")
_TYPES = {"float": np.float64, "int": np.int64, "bool": np.bool_}


@contextmanager
def create_store(path: Path) -> Iterator[h5py.File]:
    """Create an HDF5 file that takes the place of `path` once it is complete.

    Raises UsageError if it cannot be written.
    """
    with replace_atomically(path) as temporary_path:
        content = BytesIO()
        with _open_in_memory(content, "w") as file:
            yield file
        temporary_path.write_bytes(content.getbuffer())


@contextmanager
def update_store(path: Path) -> Iterator[h5py.File]:
    """Open an existing HDF5 file to change; it changes whole or not at all, and keeps its mode.

    Raises UsageError if it cannot be written.
    """
    with replace_atomically(path) as temporary_path:
        content = BytesIO(path.read_bytes())
        with _open_in_memory(content, "r+") as file:
            yield file
        temporary_path.write_bytes(content.getbuffer())
        temporary_path.chmod(path.stat().st_mode)


def _open_in_memory(content: BytesIO, mode: str) -> h5py.File:
    """Return a file that HDF5 keeps in `content`.

    Where a disk is full at the moment at which it closes a file, HDF5 crashes: it is never given
    one to write to.
    """
    # From version 1.10 on HDF5 keeps checksums of its own metadata: damage is noticed.
    return h5py.File(content, mode, libver=("v110", "v110"))


def write_dataset(
    group: h5py.Group, name: str, value: Any, layout: DatasetLayout, compressed: bool = False
) -> None:
    """Write one array or a sequence of texts; compressed: numbers by deflate."""
    if layout.kind == "text":
        dataset = group.create_dataset(name, (len(value),), dtype=_TEXT)
        if len(value):
            dataset[:] = list(value)
    else:
        array: NDArray[Any] = np.asarray(value, _TYPES[layout.kind])
        # Without elements there is nothing to cut into chunks.
        how = {"compression": "gzip", "shuffle": True} if compressed and array.size else {}
        dataset = group.create_dataset(name, data=array, **how)
    write_text(dataset, "units", layout.units)
    if layout.frame:
        write_text(dataset, "frame", layout.frame)


def write_datasets(
    group: h5py.Group,
    layouts: Mapping[str, DatasetLayout],
    values: Mapping[str, Any],
    *,
    compressed: bool = False,
    optional: bool = False,
) -> None:
    """Write all datasets of a declared layout; names may have groups ("reference/velocity").

    values: at least those that `layouts` names; optional: those that are None are left out.
    """
    for name, layout in layouts.items():
        if optional and values[name] is None:
            continue
        inner, _, last = name.rpartition("/")
        holder = group.require_group(inner) if inner else group
        write_dataset(holder, last, values[name], layout, compressed)


def write_text(holder: h5py.HLObject, name: str, text: str) -> None:
    """Write a UTF-8 attribute of any length."""
    holder.attrs.create(name, text, dtype=_TEXT)


def write_json(holder: h5py.HLObject, name: str, value: Any) -> None:
    """Write an attribute that holds JSON text."""
    write_text(holder, name, json.dumps(value, ensure_ascii=False, allow_nan=False))
