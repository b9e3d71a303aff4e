"""Reading HDF5 with every doubt turned into a clear message.

A file from elsewhere is not trusted. Nothing is allocated before type, shape and stored size were
looked at, links out of the file are refused, and whatever the HDF5 library says about damage
becomes a PlanFileError.
"""

from __future__ import annotations

import json
import math
import mmap
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from climbplan.errors import PlanFileError
from climbplan.store.hdf5_layout import DatasetLayout

# Text heaps are looked at before the HDF5 library sees them. All other metadata of plan files carry
# checksums; the collections of variable-length text do not, and on a damaged one the library may
# loop for ever or crash, which no reader could catch.
_START = b"GCOL\x01\x00\x00\x00"  # signature, version, reserved: no text holds these bytes
_COLLECTION = struct.Struct("<8sQ")  # start, size in bytes, this header included
_OBJECT = struct.Struct("<HHIQ")  # index, references, reserved, size in bytes
_ALIGNED = 8


def has_whole_text_heaps(path: Path) -> bool:
    """Return whether every text collection in the file at `path` is a chain of objects that fills
    it.
    """
    if path.stat().st_size == 0:
        return True
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_START)
        while start >= 0:
            end = _find_end(content, start)
            if end is None:
                return False
            start = content.find(_START, end)
    return True


def _find_end(content: mmap.mmap, start: int) -> int | None:
    """Return where a collection ends, None if its objects do not add up."""
    if start + _COLLECTION.size > len(content):
        return None
    _, size = _COLLECTION.unpack_from(content, start)
    end = start + size
    if end > len(content):
        return None
    offset = start + _COLLECTION.size
    while offset + _OBJECT.size <= end:
        index, _, _, length = _OBJECT.unpack_from(content, offset)
        if index == 0:  # what is left, its own header included
            return end if offset + length == end else None
        offset += _OBJECT.size + -(-length // _ALIGNED) * _ALIGNED
    return end if offset <= end else None


LARGEST_DATASET = 2**30  # [bytes]
LARGEST_NUMBER = 1e60  # beyond, products overflow: no more a number of anything than NaN is
_LARGEST_RATIO = 1100  # deflate cannot shrink further than this
_LARGEST_TEXT = 2**26  # [bytes]
_MOST_DIGITS = 60  # of a whole number
_DEEPEST = 32  # levels of JSON
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
_DTYPE_KINDS = {"float": "f", "int": "iu", "bool": "b"}
_TYPES: dict[str, type[Any]] = {"float": np.float64, "int": np.int64, "bool": np.bool_}

# What h5py raises when bytes are not what they claim to be; it has no exception of its own.
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError)


@contextmanager
def open_store(path: Path) -> Iterator[h5py.File]:
    """Open an existing HDF5 file for reading.

    Raises PlanFileError for a missing file, a directory, another format or a damaged file.
    """
    if path.is_dir():
        raise PlanFileError(f"{path}: a directory, expected a plan file")
    try:
        with path.open("rb") as stream:
            empty = not stream.read(1)
        is_hdf5 = h5py.is_hdf5(path)
    except FileNotFoundError:
        raise PlanFileError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise PlanFileError(f"{path}: cannot be read: {error}") from error
    if not is_hdf5:
        what = "empty" if empty else "not an HDF5 file"
        raise PlanFileError(f"{path}: {what}, expected a plan file")
    if not has_whole_text_heaps(path):
        raise PlanFileError(f"{path}: damaged: its texts are not whole")
    try:
        file = h5py.File(path, "r")
    except _DAMAGE as error:
        raise PlanFileError(f"{path}: damaged (cut short?): {error}") from error
    with file:
        yield file


@dataclass
class Reader:
    """Typed access to one file; dimensions are bound at their first use and hold from then on."""

    path: Path
    root: h5py.Group
    dimensions: dict[str, int] = field(default_factory=dict)
    not_finite: list[str] = field(default_factory=list)  # seen so far; absurdly large ones too
    _groups: dict[str, h5py.Group] = field(default_factory=dict, init=False, repr=False)

    def refuse(self, what: str) -> PlanFileError:
        """Return the error to raise, with the file's name."""
        return PlanFileError(f"{self.path}: {what}")

    def group(self, name: str) -> h5py.Group:
        """Return a group that must be there."""
        item = self._item(name)
        if not isinstance(item, h5py.Group):
            raise self.refuse(f"{name} is missing (expected a group)")
        return item

    def has(self, name: str) -> bool:
        """Return whether a dataset or group is there."""
        return self._item(name) is not None

    def members(self, name: str, max_members: int = 10_000) -> list[str]:
        """Return full names of the members of a group, in order."""
        group = self.group(name)
        if len(group) > max_members:
            raise self.refuse(f"{name} has {len(group)} members, expected {max_members} at most")
        try:
            return [f"{name}/{key}" for key in sorted(group)]
        except _DAMAGE as error:
            raise self.refuse(f"{name} is damaged: {error}") from error

    def datasets(
        self, group: str, layouts: Mapping[str, DatasetLayout], *, optional: bool = False
    ) -> dict[str, Any]:
        """Return all datasets of a declared layout in a group ("" for the file itself), by name.

        Arrays, and tuples of texts. optional: those that are not there are left out.
        Raises PlanFileError as `array` and `texts`.
        """
        if group:
            self.group(group)
        values: dict[str, Any] = {}
        for name, layout in layouts.items():
            path = _join_path(group, name)
            if not optional or self.has(path):
                read = self.texts if layout.kind == "text" else self.array
                values[name] = read(path, layout)
        return values

    def array(self, name: str, layout: DatasetLayout) -> NDArray[Any]:
        """Return a dataset of numbers or booleans.

        Raises PlanFileError if it is missing or of another type or shape.
        """
        dataset = self._dataset(name, layout)
        try:
            value = np.asarray(dataset[()]).astype(_TYPES[layout.kind])
        except (*_DAMAGE, MemoryError) as error:
            raise self.refuse(f"{name} is damaged: {error}") from error
        if layout.kind == "float" and not layout.may_be_nan:
            bad = ~(np.abs(value) <= LARGEST_NUMBER)
            if layout.may_be_infinite:
                bad &= ~np.isinf(value)
            if bad.any():
                self.not_finite.append(name)
        return value

    def texts(self, name: str, layout: DatasetLayout) -> tuple[str, ...]:
        """Return a dataset of texts."""
        dataset = self._dataset(name, layout)
        try:
            return tuple(_decode_text(entry) for entry in dataset[()])
        except (*_DAMAGE, MemoryError) as error:
            raise self.refuse(f"{name} is damaged: {error}") from error

    def text(self, holder: str, name: str) -> str:
        """Return a text attribute of the group `holder` ("" for the file itself)."""
        value = self._attribute(holder, name)
        if not isinstance(value, (str, bytes)):
            raise self.refuse(f"attribute {_join_path(holder, name)} is not text")
        try:
            return _decode_text(value)
        except UnicodeError as error:
            raise self.refuse(f"attribute {_join_path(holder, name)} is not UTF-8 text") from error

    def number(self, holder: str, name: str) -> float:
        """Return a number attribute; what is not finite, or absurdly large, is noted."""
        value = self._attribute(holder, name)
        if isinstance(value, np.bool_) or not isinstance(value, (np.number, int, float)):
            raise self.refuse(f"attribute {_join_path(holder, name)} is not a number")
        try:
            number = float(value)
        except _DAMAGE as error:
            raise self.refuse(f"attribute {_join_path(holder, name)} is not a number") from error
        if not abs(number) <= LARGEST_NUMBER:
            self.not_finite.append(_join_path(holder, name))
        return number

    def integer(self, holder: str, name: str) -> int:
        """Return an integer attribute."""
        value = self._attribute(holder, name)
        if isinstance(value, np.bool_) or not isinstance(value, (np.integer, int)):
            raise self.refuse(f"attribute {_join_path(holder, name)} is not an integer")
        return int(value)

    def flag(self, holder: str, name: str) -> bool:
        """Return a boolean attribute."""
        value = self._attribute(holder, name)
        if not isinstance(value, (np.bool_, bool)):
            raise self.refuse(f"attribute {_join_path(holder, name)} is not a boolean")
        return bool(value)

    def json(self, holder: str, name: str) -> Any:
        """Return the value of an attribute that holds JSON text, which can be written as such
        again.

        Numbers are finite and of a size that computing with them allows, nesting is shallow.
        """
        try:
            value = json.loads(
                self.text(holder, name),
                parse_constant=_reject_number,
                parse_float=_parse_float,
                parse_int=_parse_int,
            )
            _require_shallow(value)
            json.dumps(value, ensure_ascii=False).encode()  # halves of surrogates are no text
        except (json.JSONDecodeError, RecursionError) as error:
            raise self.refuse(
                f"attribute {_join_path(holder, name)} is not JSON: {error}"
            ) from error
        except ValueError as error:
            raise self.refuse(f"attribute {_join_path(holder, name)}: {error}") from error
        return value

    def mapping(self, name: str, needed: Sequence[str] = ()) -> dict[str, Any]:
        """Return a JSON object of the file itself, with the keys that are needed of it."""
        value = self.json("", name)
        if not isinstance(value, dict):
            raise self.refuse(f"attribute {name} is not a JSON object")
        if missing := [key for key in needed if key not in value]:
            raise self.refuse(f"attribute {name} has no entry {missing[0]!r}")
        return value

    def figures(self, name: str, needed: Sequence[str] = ()) -> dict[str, float]:
        """Return a JSON object of numbers, such as the seconds of stages."""
        value = self.mapping(name, needed)
        for key, number in value.items():
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise self.refuse(f"attribute {name}: {key!r} is {_shorten(number)}, not a number")
        return value

    def words(self, name: str) -> dict[str, str]:
        """Return a JSON object of texts, such as the solvers of stages."""
        value = self.mapping(name)
        for key, text in value.items():
            if not isinstance(text, str):
                raise self.refuse(f"attribute {name}: {key!r} is {_shorten(text)}, not text")
        return value

    def optional_number(self, name: str) -> float | None:
        """Return a number of the file itself, None where there is none."""
        return self.number("", name) if self.has_attribute("", name) else None

    def has_attribute(self, holder: str, name: str) -> bool:
        """Return whether an attribute is there."""
        try:
            return name in self._holder(holder).attrs
        except _DAMAGE as error:
            raise self.refuse(
                f"attribute {_join_path(holder, name)} is damaged: {error}"
            ) from error

    def _holder(self, holder: str) -> h5py.Group:
        return self.group(holder) if holder else self.root

    def _attribute(self, holder: str, name: str) -> Any:
        owner = self._holder(holder)
        where = f"attribute {_join_path(holder, name)}"
        if not self.has_attribute(holder, name):
            raise self.refuse(f"{where} is missing")
        try:
            if owner.attrs.get_id(name).shape != ():
                raise self.refuse(f"{where} is not a single value")
            return owner.attrs[name]
        except (*_DAMAGE, MemoryError) as error:
            raise self.refuse(f"{where} is damaged: {error}") from error

    def _item(self, name: str) -> h5py.Group | h5py.Dataset | None:
        """Return a member reached through the file's own links only."""
        if name in self._groups:
            return self._groups[name]
        parent, _, segment = name.rpartition("/")
        holder = self._item(parent) if parent else self.root
        if not isinstance(holder, h5py.Group):
            return None
        try:
            link = holder.get(segment, getlink=True)
            if link is None:
                return None
            if not isinstance(link, h5py.HardLink):
                raise self.refuse(f"{name} is a link, expected data in the file itself")
            member = holder[segment]
        except _DAMAGE as error:
            raise self.refuse(f"{name} is damaged: {error}") from error
        if isinstance(member, h5py.Group):
            self._groups[name] = member
        return member

    def _dataset(self, name: str, layout: DatasetLayout) -> h5py.Dataset:
        dataset = self._item(name)
        if not isinstance(dataset, h5py.Dataset):
            raise self.refuse(f"{name} is missing (expected a dataset)")
        try:
            dtype, shape = dataset.dtype, dataset.shape
            stored = dataset.id.get_storage_size()
            plan = dataset.id.get_create_plist()
            filters = {plan.get_filter(k)[0] for k in range(plan.get_nfilters())}
            elsewhere = dataset.is_virtual or plan.get_external_count() > 0
        except _DAMAGE as error:
            raise self.refuse(f"{name} is damaged: {error}") from error
        if layout.kind == "text":
            matches = h5py.check_string_dtype(dtype) is not None
        else:
            matches = dtype.kind in _DTYPE_KINDS[layout.kind]
        if not matches:
            raise self.refuse(f"{name} holds {dtype}, expected {layout.kind}")
        if shape is None:
            raise self.refuse(f"{name} is empty, expected shape {_format_shape(layout.shape)}")
        self._bind(name, shape, layout.shape)
        if elsewhere:
            raise self.refuse(f"{name} refers to data outside the file")
        if not filters <= _FILTERS:
            raise self.refuse(f"{name} is compressed with an unknown filter")
        claimed = math.prod(shape) * dtype.itemsize
        if claimed > LARGEST_DATASET or claimed > _LARGEST_RATIO * stored:
            raise self.refuse(
                f"{name} claims shape {_format_shape(shape)}, but the file holds {stored} bytes "
                "of it"
            )
        return dataset

    def _bind(self, name: str, shape: tuple[int, ...], expected: Sequence[str | int]) -> None:
        """Bind dimensions at their first use; refuse a shape that contradicts them."""
        fits = len(shape) == len(expected)
        if fits:
            for size, symbol in zip(shape, expected, strict=True):
                bound_size = (
                    self.dimensions.get(symbol, size) if isinstance(symbol, str) else int(symbol)
                )
                fits = fits and size == bound_size
        if not fits:
            bound_dimensions = [
                f"{symbol} = {self.dimensions[symbol]}"
                for symbol in expected
                if isinstance(symbol, str) and symbol in self.dimensions
            ]
            detail = f" with {', '.join(bound_dimensions)}" if bound_dimensions else ""
            raise self.refuse(
                f"{name} has shape {_format_shape(shape)}, expected "
                f"{_format_shape(expected)}{detail}"
            )
        for size, symbol in zip(shape, expected, strict=True):
            # "*" stands for any length and is never bound.
            if isinstance(symbol, str) and symbol != "*":
                self.dimensions[symbol] = size


def _decode_text(entry: str | bytes) -> str:
    text = entry.decode("utf-8") if isinstance(entry, bytes) else entry
    if len(text) > _LARGEST_TEXT:
        raise ValueError("text too long")
    return text.encode("utf-8").decode("utf-8")  # refuses what was smuggled in as surrogates


def _parse_float(text: str) -> float:
    number = float(text)
    if not abs(number) <= LARGEST_NUMBER:
        raise ValueError(f"the number {text[:20]} is out of range")
    return number


def _parse_int(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} digits is out of range")
    return int(text)


def _reject_number(text: str) -> Any:
    raise ValueError(f"holds {text}, a number that is not finite")


def _require_shallow(value: Any, depth: int = 0) -> None:
    if depth > _DEEPEST:
        raise ValueError(f"nested deeper than {_DEEPEST} levels")
    items = value.values() if isinstance(value, dict) else value
    for item in items if isinstance(value, dict | list) else ():
        if isinstance(item, dict | list):
            _require_shallow(item, depth + 1)


def _shorten(value: object) -> str:
    return repr(value)[:40]


def _join_path(holder: str, name: str) -> str:
    return f"{holder}/{name}" if holder else name


def _format_shape(shape: Sequence[str | int]) -> str:
    return f"({', '.join(str(s) for s in shape)}{',' if len(shape) == 1 else ''})"
