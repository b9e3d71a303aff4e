"""Groups of a plan file as Python objects, whose arrays are read when they are first asked for."""

from __future__ import annotations

import json
import shutil
import tempfile
import weakref
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from climbplan.store.hdf5_layout import DatasetLayout, Kind
from climbplan.store.hdf5_reading import Reader, open_store

_KINDS: dict[str, Kind] = {"f": "float", "i": "int", "u": "int", "b": "bool"}


class Folder:
    """A temporary directory of an unsaved plan, removed with the last object that reads from it."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="climbplan."))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


class Group:
    """A group of a plan file: arrays, attributes and groups under their names there.

    Arrays are read when they are first asked for, and cannot be written to.
    """

    def __init__(self, path: Path, name: str, folder: Folder | None) -> None:
        self._path, self._name, self._folder = path, name, folder
        with open_store(path) as file:
            group = Reader(path, file).group(name) if name else file
            self._members = {
                key: isinstance(group.get(key, getlink=True), h5py.HardLink)
                and isinstance(group[key], h5py.Group)
                for key in group
            }
            self._attributes = {key: _value(value) for key, value in group.attrs.items()}

    def __getattr__(self, name: str) -> Any:
        """Return an array, group or attribute of the file."""
        members = vars(self).get("_members", {})
        if name in members:
            value = self._group(name) if members[name] else self._array(name)
            vars(self)[name] = value
            return value
        if name in vars(self).get("_attributes", {}):
            return self._attributes[name]
        raise AttributeError(
            f"{self._description} has no {name!r}; it has {', '.join(self._names())}"
        )

    def __getitem__(self, name: str) -> Any:
        """Return the same by its path: `plan["instants/force"]`."""
        member: Any = self
        for key in name.split("/"):
            try:
                member = getattr(member, key)
            except AttributeError as error:
                raise KeyError(str(error)) from None
        return member

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._names()]

    def __repr__(self) -> str:
        return f"<{self._description}: {', '.join(self._names())}>"

    @property
    def _description(self) -> str:
        return f"group {self._name!r}"

    def _names(self) -> list[str]:
        return sorted([*self._members, *self._attributes])

    def _group(self, name: str) -> Group:
        full = f"{self._name}/{name}" if self._name else name
        return Group(self._path, full, self._folder)

    def _array(self, name: str) -> Any:
        full = f"{self._name}/{name}" if self._name else name
        with open_store(self._path) as file:
            reader = Reader(self._path, file)
            dataset = file[full]
            shape = tuple(dataset.shape or ())
            if h5py.check_string_dtype(dataset.dtype) is not None:
                return reader.texts(full, DatasetLayout(shape, kind="text"))
            kind = _KINDS.get(dataset.dtype.kind)
            if kind is None:
                raise reader.refuse(f"{full} holds {dataset.dtype}, which no plan has")
            array = reader.array(full, DatasetLayout(shape, kind=kind, may_be_nan=True))
        array.flags.writeable = False
        return array


def _value(value: Any) -> Any:
    """Convert a stored attribute to a Python value; JSON text is parsed."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            return json.loads(value)
        except (ValueError, RecursionError):
            return value
    return value.item() if isinstance(value, np.generic) else value
