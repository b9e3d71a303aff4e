"""Bookshelf plans as HDF5 files: writing them, and reading them back exactly."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5py

from climbplan.bookshelf.plan.shelf_plan import STATUSES, ShelfPlan, Solutions, Totals
from climbplan.bookshelf.scene.shelf_scene import PublishedTolerances, Scenes, Shelf
from climbplan.deprecation import current_method_name
from climbplan.errors import PlanFileError, UsageError
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets
from climbplan.store.root_attributes import read_header, require_finite, require_plan, write_header

FORMAT = "climbplan/bookshelf"
FORMAT_VERSION = 1

# S scenes, B = n + 1 books, P = 5 n + 2
THETA = DatasetLayout(("S", "P"), "m, rad", "shelf")
SOLUTION = {
    "pose": DatasetLayout(("S", "B", 3), "m, rad", "shelf", may_be_nan=True),
    "state": DatasetLayout(("S", "B"), kind="int"),
    "slot": DatasetLayout(("S",), kind="int"),
    "objective": DatasetLayout(("S",), "mm^2", may_be_infinite=True),
    "bound": DatasetLayout(("S",), "mm^2", may_be_infinite=True),
    "time": DatasetLayout(("S",), "s"),
    "candidates_tried": DatasetLayout(("S",), kind="int"),
    "nodes": DatasetLayout(("S",), kind="int"),
    "overlap": DatasetLayout(("S",), "m", may_be_nan=True),
}
SOLUTION_TEXTS = {
    "status": DatasetLayout(("S",), kind="text"),
    "message": DatasetLayout(("S",), kind="text"),
}
_TEXTS = DatasetLayout(("*",), kind="text")
_MEANINGS = ("contact", "published")

_NOTES = {
    "objective_is": "sum of the movement costs of all scenes with a placement [mm^2]: stored books "
    "(dx^2 + dy^2) / (1 mm)^2 + (cos a - cos a0)^2",
    "states": "0 flat left, 1 leaning left, 2 upright, 3 leaning right, 4 flat right, -1 without a "
    "placement",
    "theta_columns": "x, y, angle, height, width of each stored book from left to right, then "
    "height and width of the inserted one; angle > 0 tilts left",
}


def write_shelf_plan(plan: ShelfPlan, path: Path) -> None:
    """Write a plan; the file appears whole or not at all, in place of one that is there.

    An empty `created` or `climbplan_version` becomes now and this version. Raises UsageError if
    the file cannot be written.
    """
    with create_store(path) as file:
        _write_header(file, plan)
        _write_shelf(file.create_group("shelf"), plan.shelf)
        write_dataset(file.create_group("scenes"), "theta", plan.scenes.theta("m"), THETA)
        solution = file.create_group("solution")
        write_datasets(solution, {**SOLUTION, **SOLUTION_TEXTS}, vars(plan.solutions))


def read_shelf_plan(path: Path) -> ShelfPlan:
    """Read the plan in a file, exactly as it was written.

    Raises:
        PlanFileError: the file is not a whole bookshelf plan: another format or version, missing or
            misshapen data, NaN where numbers must be.
    """
    plan = read_unchecked_plan(path)
    require_finite(path, plan)
    if faults := plan.scenes.faults():
        raise PlanFileError(f"{path}: {faults[0]}")
    return plan


def read_unchecked_plan(path: Path) -> ShelfPlan:
    """Read a plan whose numbers may be NaN or infinite: `not_finite` lists them for a check."""
    with open_store(path) as file:
        reader = Reader(path, file)
        require_plan(reader, FORMAT_VERSION, FORMAT)
        return _read(reader)


def _write_header(file: h5py.File, plan: ShelfPlan) -> None:
    totals = plan.totals
    texts = {"title": plan.title, "meaning": plan.meaning, "method": plan.method}
    write_header(
        file,
        plan,
        FORMAT,
        FORMAT_VERSION,
        texts={"status": totals.status, **texts, **_NOTES},
        numbers={"objective": totals.objective, "bound": totals.bound, "gap": totals.gap},
    )


def _write_shelf(group: h5py.Group, shelf: Shelf) -> None:
    numbers = asdict(shelf)
    published = numbers.pop("published")
    for name, value in numbers.items():
        group.attrs[name] = float(value)
    for name, value in published.items():
        group.attrs[f"published_{name}"] = float(value)


def _read_shelf(reader: Reader) -> Shelf:
    names = [field.name for field in fields(Shelf) if field.name != "published"]
    numbers = {name: reader.number("shelf", name) for name in names}
    published = {
        field.name: reader.number("shelf", f"published_{field.name}")
        for field in fields(PublishedTolerances)
    }
    try:
        return Shelf(**numbers, published=PublishedTolerances(**published))
    except UsageError as error:
        raise reader.refuse(str(error)) from error


def _read(reader: Reader) -> ShelfPlan:
    reader.group("scenes")
    theta = reader.array("scenes/theta", THETA)
    try:
        scenes = Scenes.from_theta_unchecked(theta)
    except UsageError as error:
        raise reader.refuse(f"scenes/theta: {error}") from error
    reader.dimensions["B"] = scenes.count + 1
    reader.group("solution")
    arrays: dict[str, Any] = reader.datasets("solution", SOLUTION)
    arrays |= reader.datasets("solution", SOLUTION_TEXTS)
    for name, values, allowed in (
        ("status", (reader.text("", "status"), *arrays["status"]), STATUSES),
        ("meaning", (reader.text("", "meaning"),), _MEANINGS),
    ):
        if strange := [value for value in values if value not in allowed]:
            raise reader.refuse(f"{name} {strange[0]!r}, expected one of {', '.join(allowed)}")
    return ShelfPlan(
        title=reader.text("", "title"),
        shelf=_read_shelf(reader),
        meaning=reader.text("", "meaning"),
        method=current_method_name("bookshelf", reader.text("", "method")),
        scenes=scenes,
        solutions=Solutions(**arrays),
        totals=Totals(
            reader.text("", "status"),
            reader.number("", "objective"),
            reader.optional_number("bound"),
            reader.optional_number("gap"),
        ),
        **read_header(reader),
    )
