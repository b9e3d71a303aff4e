"""Datasets as HDF5 files, format `climbplan/dataset`.

parameters (n, p)   integers (n, q)     columns: parameter_names (p), integer_names (q)
feasible, objective, bound, time, seed, row, status, message (n)
solution/...        arrays (n, ...) as the attribute `solution_layout` (JSON) says
split/train, test   (n) masks, where `data split` made them
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.store.dataset import ANSWERED, STATUSES, Dataset, DatasetFrame, build_solution_layout
from climbplan.store.hdf5_layout import DatasetLayout, Kind
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets
from climbplan.store.root_attributes import Origin, read_root, require_other, write_root

FORMAT = "climbplan/dataset"
FORMAT_VERSION = 1

_ARRAYS = {
    "parameters": DatasetLayout(("n", "p"), may_be_nan=True),
    "feasible": DatasetLayout(("n",), kind="bool"),
    "integers": DatasetLayout(("n", "q"), kind="int"),
    "objective": DatasetLayout(("n",), may_be_nan=True),
    "bound": DatasetLayout(("n",), may_be_infinite=True),
    "time": DatasetLayout(("n",), "s"),
    "seed": DatasetLayout(("n",), kind="int"),
    "row": DatasetLayout(("n",), kind="int"),
}
_TEXTS = {
    "status": DatasetLayout(("n",), kind="text"),
    "message": DatasetLayout(("n",), kind="text"),
}
_NAMES = {
    "parameter_names": DatasetLayout(("p",), kind="text"),
    "integer_names": DatasetLayout(("q",), kind="text"),
}
_MASK = DatasetLayout(("n",), kind="bool")
_SAFE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_MOST_ARRAYS = 64
_LARGEST = 1e30  # beyond this squares overflow
_KINDS: dict[str, Kind] = {"float": "float", "int": "int", "bool": "bool", "text": "text"}


def write_dataset_file(data: Dataset, path: Path) -> None:
    """Write a dataset; the file appears whole or not at all. Raises UsageError if it cannot."""
    frame = data.frame
    with create_store(path) as file:
        layouts = {
            name: {
                "shape": list(layout.shape[1:]),
                "units": layout.units,
                "frame": layout.frame,
                "kind": layout.kind,
            }
            for name, layout in frame.layouts.items()
        }
        texts = {"title": data.title, "kind": frame.kind, "problem": frame.problem}
        origin = Origin(
            name=data.name,
            spec_text=data.spec_text,
            spec_sha256=data.spec_sha256,
            seed=data.base_seed,
            verified=data.verified,
            created=data.created,
            climbplan_version=data.climbplan_version,
        )
        write_root(
            file,
            origin,
            FORMAT,
            FORMAT_VERSION,
            texts={"status": data.overall, **texts},
            numbers={},
            objects={
                "facts": dict(frame.facts),
                "timings": dict(data.timings),
                "solvers": dict(data.solvers),
                "solution_layout": layouts,
            },
        )
        for name, layout in _ARRAYS.items():
            unit = frame.objective_unit if name in ("objective", "bound") else layout.units
            write_dataset(file, name, vars(data)[name], replace(layout, units=unit))
        write_datasets(file, _TEXTS, vars(data))
        write_datasets(file, _NAMES, vars(frame))
        solution = file.create_group("solution")
        write_datasets(solution, frame.layouts, data.solution)
        if data.train is not None and data.test is not None:
            split = file.create_group("split")
            write_dataset(split, "train", data.train, _MASK)
            write_dataset(split, "test", data.test, _MASK)


def read_dataset_file(path: Path) -> Dataset:
    """Return the dataset in a file, exactly as it was written; nothing in it is ever run.

    Raises PlanFileError for another format, missing or misshapen data, and for numbers that are not
    finite, or a status that denies it, in a row that claims an answer.
    """
    with open_store(path) as file:
        return _read(Reader(path, file))


def _read(reader: Reader) -> Dataset:
    require_other(reader, FORMAT_VERSION, FORMAT, "a dataset")
    root = read_root(reader)
    root["base_seed"] = root.pop("seed")  # rows have seeds of their own
    arrays: dict[str, Any] = reader.datasets("", _ARRAYS)
    texts: dict[str, Any] = reader.datasets("", _TEXTS)
    names: dict[str, Any] = reader.datasets("", _NAMES)
    layouts = _read_layouts(reader)
    reader.group("solution")
    solution = {
        name: np.array(value, np.str_) if layouts[name].kind == "text" else value
        for name, value in reader.datasets("solution", layouts).items()
    }
    masks: dict[str, Any] = {}
    if reader.has("split"):
        masks = {name: reader.array(f"split/{name}", _MASK) for name in ("train", "test")}
        if (masks["train"] & masks["test"]).any():
            raise reader.refuse("split: a row is in both train and test")
    frame = DatasetFrame(
        kind=reader.text("", "kind"),
        problem=reader.text("", "problem"),
        facts=reader.mapping("facts"),
        layouts=layouts,
        objective_unit=_read_objective_unit(reader),
        **names,
    )
    data = Dataset(
        **root,
        frame=frame,
        solution=solution,
        **arrays,
        **texts,
        **masks,
        title=reader.text("", "title"),
        timings=reader.figures("timings"),
        solvers=reader.mapping("solvers"),
    )
    _require_sound(reader, data)
    return data


def _read_objective_unit(reader: Reader) -> str:
    unit = reader.root["objective"].attrs.get("units", "")
    return unit if isinstance(unit, str) else ""


def _require_sound(reader: Reader, data: Dataset) -> None:
    """Refuse a dataset without rows, or with rows that claim an answer and have none."""
    if not data.count:
        raise reader.refuse("no rows")
    if reader.not_finite:
        raise reader.refuse(f"numbers that are not finite in {', '.join(reader.not_finite)}")
    if foreign := sorted(set(data.status) - set(STATUSES)):
        raise reader.refuse(f"status {foreign[0]!r}, expected one of {', '.join(STATUSES)}")
    answered = np.array([status in ANSWERED for status in data.status], bool)
    if (answered != data.feasible).any():
        row = int(np.flatnonzero(answered != data.feasible)[0])
        raise reader.refuse(f"row {row}: status {data.status[row]!r} and `feasible` disagree")
    if (data.time < 0).any():
        raise reader.refuse("negative time")
    infinite = np.isinf(data.parameters).any(axis=1)
    if infinite.any():
        raise reader.refuse(f"row {int(np.argmax(infinite))}: parameters are infinite")
    for name, value in {
        "time": data.time,
        "parameters": data.parameters,
        "objective": data.objective,
        **{
            f"solution/{key}": array
            for key, array in data.solution.items()
            if array.dtype.kind in "fi"
        },
    }.items():
        table = value.reshape(len(value), -1)
        bad = ~np.isfinite(table).all(axis=1) & data.feasible
        if bad.any():
            raise reader.refuse(f"row {int(np.argmax(bad))}: {name} is not finite")
        large = ((np.abs(table) > _LARGEST) & np.isfinite(table)).any(axis=1)
        if large.any():
            row = int(np.argmax(large))
            raise reader.refuse(f"row {row}: {name} holds numbers beyond {_LARGEST:g}")


def _read_layouts(reader: Reader) -> dict[str, DatasetLayout]:
    """Return the layouts of the solution's arrays, as the file itself states them."""
    stated = reader.mapping("solution_layout")
    if len(stated) > _MOST_ARRAYS:
        raise reader.refuse(f"solution_layout names {len(stated)} arrays, expected {_MOST_ARRAYS}")
    layouts = {}
    for name, entry in stated.items():
        if not _SAFE_NAME.fullmatch(name) or not isinstance(entry, dict):
            raise reader.refuse(f"solution_layout: {name!r} does not describe an array")
        shape, kind = entry.get("shape"), entry.get("kind")
        if not isinstance(shape, list) or not all(type(k) is int and k >= 0 for k in shape):
            raise reader.refuse(f"solution_layout: shape of {name!r} is {shape!r}")
        if not isinstance(kind, str) or kind not in _KINDS:
            raise reader.refuse(f"solution_layout: kind of {name!r} is {kind!r}")
        units, frame = entry.get("units"), entry.get("frame")
        if not isinstance(units, str) or not isinstance(frame, str):
            raise reader.refuse(f"solution_layout: units or frame of {name!r} are missing")
        layouts[name] = build_solution_layout(shape, units, frame, _KINDS[kind])
    return layouts
