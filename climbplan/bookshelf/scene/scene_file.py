"""Files of scenes (HDF5): `theta` rows in a group, in metres or millimetres as their units say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from climbplan.bookshelf.scene.shelf_scene import Scenes, Unit
from climbplan.errors import PlanFileError
from climbplan.schema.fields import find_closest_name
from climbplan.store.dataset_file import FORMAT as DATASET_FORMAT
from climbplan.store.dataset_file import read_dataset_file
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_json, write_text

FORMAT = "climbplan/scenes"
FORMAT_VERSION = 1
GROUP = "scenes"
DATASET_KIND = "bookshelf"  # of datasets of scenes
_THETA = DatasetLayout(("S", "P"), "m, rad", "shelf")


class NoSuchGroup(PlanFileError):
    """A sound file without the requested group."""


def write_scenes(scenes: Scenes, path: Path, origin: dict[str, Any], group: str = GROUP) -> None:
    """Write scenes, with where they come from (plain values: generator, seed, its numbers).

    Raises:
        UsageError: the file cannot be written.
    """
    with create_store(path) as file:
        write_text(file, "format", FORMAT)
        file.attrs["format_version"] = FORMAT_VERSION
        write_json(file, "origin", origin)
        write_text(
            file,
            "theta_columns",
            "x, y, angle, height, width of each stored book from left to right, then height and "
            "width of the inserted one; angle > 0 tilts left",
        )
        write_dataset(file.create_group(group), "theta", scenes.theta("m"), _THETA)


def read_scenes(path: Path, group: str = "") -> Scenes:
    """Scenes of a group; of the only group with `theta` if none is named; those of a dataset.

    Raises:
        NoSuchGroup: none of that name, or several and no name.
        PlanFileError: missing or damaged file, units that are not lengths.
        WrongScenes: rows that cannot describe books, each by its number.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        # Files of scenes that others wrote need not have a format.
        if reader.has_attribute("", "format") and reader.text("", "format") == DATASET_FORMAT:
            return _read_dataset_scenes(path, group)
        holder = _find_group(reader, file, group.strip("/"))
        name = f"{holder}/theta" if holder else "theta"
        theta = reader.array(name, _THETA)
        return Scenes.from_theta(theta, _read_unit(reader, name))


def _read_dataset_scenes(path: Path, group: str) -> Scenes:
    """Read the scenes of a dataset, except for rows whose scene could not be drawn."""
    if group:
        raise NoSuchGroup(f"{path}: is a dataset, which has no groups of scenes")
    data = read_dataset_file(path)
    if data.frame.kind != DATASET_KIND:
        raise PlanFileError(f"{path}: is a dataset of another problem, expected bookshelf scenes")
    return Scenes.from_theta(data.parameters[data.drawn], "m")


def _find_group(reader: Reader, file: h5py.File, group: str) -> str:
    """Find the group to read, "" for the file itself."""
    if group:
        if reader.has(group) and reader.has(f"{group}/theta"):
            return group
        groups = _list_groups(reader, file)
        closest = find_closest_name(group, groups)
        hint = f" (did you mean {closest!r}?)" if closest else ""
        listed = ", ".join(repr(name) for name in groups) or "none"
        raise NoSuchGroup(
            f"{reader.path}: no group {group!r} with a dataset `theta`, there is {listed}{hint}"
        )
    if reader.has("theta"):
        return ""
    groups = _list_groups(reader, file)
    if len(groups) != 1:
        listed = ", ".join(repr(name) for name in groups) or "none"
        raise NoSuchGroup(
            f"{reader.path}: expected one group with a dataset `theta`, there is {listed}"
        )
    return groups[0]


def _list_groups(reader: Reader, file: h5py.File) -> list[str]:
    names = [
        name for name in sorted(file) if isinstance(file.get(name, getlink=True), h5py.HardLink)
    ]
    return [name for name in names if isinstance(file[name], h5py.Group) and "theta" in file[name]]


def _read_unit(reader: Reader, name: str) -> Unit:
    """Read the unit of lengths from the dataset, or from the file if the dataset has none."""
    units = ""
    for item in (reader.root[name], reader.root):
        if not units and isinstance(item.attrs.get("units"), str):
            units = item.attrs["units"]
    names = units.replace(",", " ").split()
    if "mm" in names:
        return "mm"
    if "m" in names:
        return "m"
    raise reader.refuse(f"{name}: expected an attribute `units` with m or mm, got {units!r}")
