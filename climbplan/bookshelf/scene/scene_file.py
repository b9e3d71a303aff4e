"""Files of scenes (HDF5): `theta` rows in a group, in metres or millimetres as their units say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from climbplan.bookshelf.scene.shelf_scene import Scenes, Unit
from climbplan.errors import PlanFileError
from climbplan.schema.fields import nearest
from climbplan.store.dataset_file import FORMAT as DATASET_FORMAT
from climbplan.store.dataset_file import read_dataset_file
from climbplan.store.hdf5_layout import Layout
from climbplan.store.hdf5_reading import Reader, opened_store
from climbplan.store.hdf5_writing import new_store, write_dataset, write_json, write_text

FORMAT = "climbplan/scenes"
FORMAT_VERSION = 1
GROUP = "scenes"
DATASET_KIND = "bookshelf"  # of datasets of scenes
_THETA = Layout(("S", "P"), "m, rad", "shelf")


class NoSuchGroup(PlanFileError):
    """The file is sound, but not the group that was asked for."""


def write_scenes(scenes: Scenes, path: Path, origin: dict[str, Any], group: str = GROUP) -> None:
    """Write scenes, with where they come from (plain values: generator, seed, its numbers).

    Raises:
        UsageError: the file cannot be written.
    """
    with new_store(path) as file:
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
    with opened_store(path) as file:
        reader = Reader(path, file)
        # Files of scenes that others wrote need not have a format.
        if reader.has_attribute("", "format") and reader.text("", "format") == DATASET_FORMAT:
            return _drawn_scenes(path, group)
        holder = _holder(reader, file, group.strip("/"))
        name = f"{holder}/theta" if holder else "theta"
        theta = reader.array(name, _THETA)
        return Scenes.from_theta(theta, _unit(reader, name))


def _drawn_scenes(path: Path, group: str) -> Scenes:
    """The scenes of a dataset, but for rows whose scene could not be drawn."""
    if group:
        raise NoSuchGroup(f"{path}: is a dataset, which has no groups of scenes")
    data = read_dataset_file(path)
    if data.frame.kind != DATASET_KIND:
        raise PlanFileError(f"{path}: is a dataset of another problem, expected bookshelf scenes")
    return Scenes.from_theta(data.parameters[data.drawn], "m")


def _holder(reader: Reader, file: h5py.File, group: str) -> str:
    """The group to read, "" for the file itself."""
    if group:
        if reader.has(group) and reader.has(f"{group}/theta"):
            return group
        known = _groups(reader, file)
        near = nearest(group, known)
        hint = f" (did you mean {near!r}?)" if near else ""
        listed = ", ".join(repr(name) for name in known) or "none"
        raise NoSuchGroup(
            f"{reader.path}: no group {group!r} with a dataset `theta`, there is {listed}{hint}"
        )
    if reader.has("theta"):
        return ""
    known = _groups(reader, file)
    if len(known) != 1:
        listed = ", ".join(repr(name) for name in known) or "none"
        raise NoSuchGroup(
            f"{reader.path}: expected one group with a dataset `theta`, there is {listed}"
        )
    return known[0]


def _groups(reader: Reader, file: h5py.File) -> list[str]:
    names = [
        name for name in sorted(file) if isinstance(file.get(name, getlink=True), h5py.HardLink)
    ]
    return [name for name in names if isinstance(file[name], h5py.Group) and "theta" in file[name]]


def _unit(reader: Reader, name: str) -> Unit:
    """Unit of lengths: that of the dataset, or of the whole file if the dataset has none."""
    units = ""
    for item in (reader.root[name], reader.root):
        if not units and isinstance(item.attrs.get("units"), str):
            units = item.attrs["units"]
    words = units.replace(",", " ").split()
    if "mm" in words:
        return "mm"
    if "m" in words:
        return "m"
    raise reader.refuse(f"{name}: expected an attribute `units` with m or mm, got {units!r}")
