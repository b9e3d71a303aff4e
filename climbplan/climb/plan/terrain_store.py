"""The terrain inside a plan file: surfaces, obstacles and the body's free space."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from climbplan.climb.plan import layout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_text
from climbplan.terrain.holds import Hold
from climbplan.terrain.model import FreeRegion, Terrain
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Surface, Tube


def write_terrain(group: h5py.Group, terrain: Terrain) -> None:
    """Write all surfaces with friction and limb permissions, obstacles and free regions."""
    surfaces = group.create_group("surfaces")
    for index, surface in enumerate(terrain.surfaces):
        _write_surface(surfaces.create_group(_format_key(index)), surface)
    write_dataset(group, "allowed", terrain.allowed, layout.ALLOWED)
    obstacles = group.create_group("obstacles")
    for index, solid in enumerate(terrain.obstacles):
        target = obstacles.create_group(_format_key(index))
        _write_half_spaces(target, solid)
        write_dataset(target, "vertices", solid.vertices, layout.VERTICES)
    choices = group.create_group("free_choices")
    for index, choice in enumerate(terrain.free_choices):
        options = choices.create_group(_format_key(index))
        for option, free in enumerate(choice):
            _write_half_spaces(options.create_group(_format_key(option)), free)
    if terrain.scan is not None:
        scan = group.create_group("scan")
        for name, shape in layout.SCAN.items():
            write_dataset(scan, name, vars(terrain.scan)[name], shape)
        for name in layout.SCAN_NUMBERS:
            scan.attrs[name] = float(vars(terrain.scan)[name])
        if terrain.scan.finger_depth:
            scan.attrs[layout.SCAN_DEPTH] = float(terrain.scan.finger_depth)


def read_terrain(reader: Reader, where: str) -> Terrain:
    """Return the terrain in the group `where`.

    Raises PlanFileError for what is missing or misshapen, and for surfaces of an unknown kind.
    """
    surfaces = tuple(_read_surface(reader, name) for name in reader.members(f"{where}/surfaces"))
    if not surfaces:
        raise reader.refuse(f"{where}/surfaces holds no surface")
    if len({type(surface) for surface in surfaces}) > 1 or (
        isinstance(surfaces[0], Tube) and len(surfaces) > 1
    ):
        raise reader.refuse(f"{where}/surfaces mixes a tube with other surfaces")
    reader.dimensions["R"] = len(surfaces)
    obstacles = tuple(
        Solid(
            vertices=reader.array(f"{name}/vertices", layout.VERTICES),
            **_read_half_spaces(reader, name),
        )
        for name in reader.members(f"{where}/obstacles")
    )
    choices = tuple(
        tuple(FreeRegion(**_read_half_spaces(reader, option)) for option in reader.members(choice))
        for choice in reader.members(f"{where}/free_choices")
    )
    allowed = reader.array(f"{where}/allowed", layout.ALLOWED)
    scan = _read_scan(reader, f"{where}/scan") if reader.has(f"{where}/scan") else None
    return Terrain(surfaces, allowed, obstacles, choices, scan)


def _read_scan(reader: Reader, where: str) -> RawSurface:
    fields: dict[str, Any] = reader.datasets(where, layout.SCAN)
    triangles, corners = fields["triangles"], len(fields["vertices"])
    if not len(triangles) or triangles.min() < 0 or triangles.max() >= corners:
        raise reader.refuse(f"{where}/triangles names a corner that is not there, or is empty")
    numbers = [*layout.SCAN_NUMBERS]
    if reader.has_attribute(where, layout.SCAN_DEPTH):
        numbers.append(layout.SCAN_DEPTH)
    fields |= {name: reader.number(where, name) for name in numbers}
    return RawSurface(**fields)


def _format_key(index: int) -> str:
    """Return names of members in numerical order when sorted as text."""
    return f"{index:04d}"


def _write_half_spaces(group: h5py.Group, body: Solid | FreeRegion) -> None:
    write_text(group, "name", body.name)
    write_dataset(group, "A", body.A, layout.HALF_SPACES["A"])
    write_dataset(group, "b", body.b, layout.HALF_SPACES["b"])


def _read_half_spaces(reader: Reader, name: str) -> dict[str, Any]:
    A = reader.array(f"{name}/A", layout.HALF_SPACES["A"])
    b = reader.array(f"{name}/b", layout.HALF_SPACES["b"])
    if len(A) != len(b):
        raise reader.refuse(f"{name}/A has {len(A)} rows and {name}/b {len(b)}")
    return {"name": reader.text(name, "name"), "A": A, "b": b}


def _write_surface(group: h5py.Group, surface: Surface) -> None:
    write_text(group, "name", surface.name)
    group.attrs["friction"] = float(surface.friction)
    if isinstance(surface, Region):
        write_text(group, "kind", "flat")
        group.attrs["offset"] = float(surface.offset)
        for name, shape in layout.FLAT.items():
            write_dataset(group, name, vars(surface)[name], shape)
        if surface.hold is not None:
            _write_hold(group.create_group("hold"), surface.hold)
    elif isinstance(surface, Tube):
        write_text(group, "kind", "tube")
        for name in layout.TUBE_NUMBERS:
            group.attrs[name] = float(vars(surface)[name])
        write_dataset(group, "center", surface.center, layout.TUBE["center"])
    else:
        raise TypeError(f"no file layout for surfaces of type {type(surface).__name__}")
    if surface.standoff:
        group.attrs["standoff"] = float(surface.standoff)


def _write_hold(group: h5py.Group, hold: Hold) -> None:
    group.attrs["undercut"] = float(hold.undercut)
    for name, shape in layout.HOLD.items():
        write_dataset(group, name, vars(hold)[name], shape)


def _read_hold(reader: Reader, where: str) -> Hold:
    arrays = reader.datasets(where, layout.HOLD)
    return Hold(undercut=reader.number(where, "undercut"), **arrays)


def _read_surface(reader: Reader, where: str) -> Surface:
    kind = reader.text(where, "kind")
    name, friction = reader.text(where, "name"), reader.number(where, "friction")
    has_standoff = reader.has_attribute(where, "standoff")
    standoff = reader.number(where, "standoff") if has_standoff else 0.0
    if kind == "flat":
        arrays = {
            field: reader.array(f"{where}/{field}", shape) for field, shape in layout.FLAT.items()
        }
        corners = len(arrays["vertices"])
        if corners < 3 or len(arrays["A"]) != corners or len(arrays["b"]) != corners:
            raise reader.refuse(f"{where} has {corners} corners, {len(arrays['b'])} edges")
        return Region(
            name=name,
            offset=reader.number(where, "offset"),
            friction=friction,
            standoff=standoff,
            hold=_read_hold(reader, f"{where}/hold") if reader.has(f"{where}/hold") else None,
            **arrays,
        )
    if kind == "tube":
        center = reader.array(f"{where}/center", layout.TUBE["center"])
        numbers = {field: reader.number(where, field) for field in layout.TUBE_NUMBERS}
        middle = np.asarray(center)
        return Tube(name=name, center=middle, friction=friction, standoff=standoff, **numbers)
    raise reader.refuse(f"{where} is a surface of unknown kind {kind!r}")
