"""Mutations of HDF5 files: datasets and attributes of other shape, type and value, or none."""

from __future__ import annotations

import hashlib
import json
import random
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mutations import mutated_yaml

Change = Callable[[h5py.File], None]


def dataset_changes(name: str, values: Any) -> Iterator[Change]:
    """What a dataset can be replaced by."""

    def instead(new: Any) -> Change:
        def change(file: h5py.File) -> None:
            del file[name]
            file[name] = new

        return change

    def with_last(value: Any) -> Any:
        changed = values.copy()
        changed.reshape(-1)[-1:] = value
        return changed

    def huge(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, (10**6, 10**6), "f8", chunks=(100, 100))

    def group(file: h5py.File) -> None:
        del file[name]
        file.create_group(name)

    def gone(file: h5py.File) -> None:
        del file[name]

    def link(file: h5py.File) -> None:
        del file[name]
        file[name] = h5py.SoftLink("/")

    values = np.asarray(values)
    yield from (gone, group, link)
    if values.dtype.kind in "OS":
        yield instead([b"\xff\xfe"] * max(len(values), 1))
        yield instead(["x" * 10_000] * max(len(values), 1))
        yield instead(["../../x\n\0".replace("\0", "")] * max(len(values), 1))
        yield instead(["twice"] * max(len(values), 2))
        yield instead(values[: len(values) // 2])
        yield instead(np.zeros(max(len(values), 1)))
        return
    yield huge
    yield instead(values[..., None])
    yield instead(values[:0])
    yield instead(values[: max(len(values) // 2, 1)] if values.ndim else values)
    yield instead(np.concatenate([values, values]) if values.ndim else values)
    yield instead(values.astype("S8"))
    yield instead(h5py.Empty("f"))
    yield instead(np.zeros_like(values))
    if values.dtype.kind == "f":
        for value in (np.nan, np.inf, 1e300, -1e40, 1e-300, -1.0, 1e9):
            yield instead(with_last(value))
            yield instead(np.full_like(values, value))
        yield instead(np.zeros(values.shape, np.int64))
        yield instead(-values)
        yield instead(values[::-1] if values.ndim else values)
        yield instead(values * (1 + 1e-3))
        yield instead(values.astype(complex))
    elif values.dtype.kind in "iu":
        for value in (-7, -1, 99, 2**62):
            yield instead(with_last(value))
            yield instead(np.full_like(values, value))
        yield instead(values.astype(float))
    else:
        yield instead(~values)
        yield instead(np.ones_like(values))


def attribute_changes(holder: str, name: str) -> Iterator[Change]:
    """What an attribute can be replaced by."""
    values: tuple[Any, ...] = ("", "[]", "{}", '{"a": [null, "b"]}', "[[1]]", np.nan, 1e300, -1)
    numbers = (0, 1e-300, 1e9, True, np.inf, 3.5, "x" * 10_000, "NaN", "null", b"\xff\xfe")
    for value in (*values, *numbers, 2**62, np.array([1.0, 2.0]), h5py.Empty("f")):
        yield lambda file, value=value: file[holder].attrs.__setitem__(name, value)
    yield lambda file: file[holder].attrs.__delitem__(name)


def changes_of(path: Path) -> list[tuple[str, list[Change]]]:
    """All changes of every dataset and attribute, by its name."""
    found: list[tuple[str, list[Change]]] = []

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset):
            found.append((name, list(dataset_changes(name, item[()]))))
            return
        for attribute in item.attrs:
            label = f"{name}@{attribute}"
            found.append((label, list(attribute_changes(name, attribute))))

    with h5py.File(path) as file:
        file.visititems(visit)
        visit("/", file)
    return found


def one_change_each(path: Path) -> list[tuple[str, Change]]:
    """One change of every dataset and attribute, which its name decides."""
    return [
        (label, options[zlib.crc32(label.encode()) % len(options)])
        for label, options in changes_of(path)
    ]


def mutate_plan(path: Path, rng: random.Random) -> str:
    """Change a plan file in its place; says what was done."""
    which = rng.choice(["hdf5"] * 6 + ["spec"] * 3 + ["json"] * 3 + ["bytes"] * 2)
    if which == "bytes":
        return _bytes(path, rng)
    if which == "spec":
        return _stored_text(path, rng)
    if which == "json":
        return _stored_json(path, rng)
    done = []
    for label, options in rng.sample(changes_of(path), rng.choice([1, 1, 2])):
        index = rng.randrange(len(options))
        with h5py.File(path, "r+") as file:
            options[index](file)
        done.append(f"change {index} of {label}")
    return "; ".join(done)


def _bytes(path: Path, rng: random.Random) -> str:
    content = bytearray(path.read_bytes())
    if rng.random() < 0.3:
        at = rng.randrange(len(content))
        path.write_bytes(content[:at])
        return f"cut at byte {at}"
    # Headers are more telling than data
    reach = rng.choice([600, 5000, len(content)])
    places = [rng.randrange(min(reach, len(content))) for _ in range(rng.choice([1, 1, 4, 64]))]
    for place in places:
        content[place] = rng.randrange(256)
    path.write_bytes(content)
    return f"bytes at {places[:8]}"


def _stored_text(path: Path, rng: random.Random) -> str:
    """The spec or a robot's text in the file, with its fingerprint put right."""
    with h5py.File(path, "r+") as file:
        texts = [
            (name, attribute)
            for name, attribute in (
                ("/", "spec"), ("robot", "source"), ("robot", "urdf"), ("limms", "source")
            )
            if name in file and attribute in file[name].attrs
        ]  # fmt: skip
        if not texts:
            return "as it was"
        name, attribute = rng.choice(texts)
        words, content = mutated_yaml(str(file[name].attrs[attribute]).encode(), rng)
        text = content.decode("utf-8", "replace").replace("\0", "")
        file[name].attrs[attribute] = text
        if attribute == "spec" and rng.random() < 0.8:
            file.attrs["spec_sha256"] = hashlib.sha256(text.encode()).hexdigest()
    return f"{name}@{attribute}: {words}"


def _stored_json(path: Path, rng: random.Random) -> str:
    """A summary table that lacks an entry, or holds one of another type."""
    with h5py.File(path, "r+") as file:
        names = [n for n in file.attrs if str(file.attrs[n]).startswith(("{", "["))]
        name = rng.choice(names or ["timings"])
        value = json.loads(str(file.attrs.get(name, "{}")))
        odd = rng.choice([None, "x", -1, 1e300, [], {}, [None], {"a": {}}, True, "9" * 400])
        if isinstance(value, dict) and value:
            key = rng.choice(sorted(value))
            if rng.random() < 0.5:
                del value[key]
                words = f"{key} left out"
            else:
                value[key] = odd
                words = f"{key}: {odd!r}"[:60]
        else:
            value, words = odd, repr(odd)[:60]
        file.attrs[name] = json.dumps(value)
    return f"{name}: {words}"
