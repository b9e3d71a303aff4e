"""A URDF as Drake reads it: collision geometry and inertias as they are, nothing to look at.

Visual geometry and transmissions are left out. Meshes, of which Drake collides convex hulls, are
written as such beside the document, since it reads neither STL nor COLLADA. A root link `world`
and its joint, by which some files fix a robot to the ground, are left out as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import trimesh

from climbplan.errors import UsageError
from climbplan.schema.robots.urdf.meshes import find_mesh
from climbplan.schema.robots.xml import UrdfFault

_WORLD = "world"


def write_robot_document(
    text: str, urdf: Path, packages: Mapping[str, str], directory: Path
) -> Path:
    """Write the URDF `text` for Drake into a directory, with its meshes, and return its path.

    Args:
        text: the URDF.
        urdf: where that text is from, which relative names of meshes start from.
        packages: package name -> directory, for `package://` names.
        directory: an existing directory.

    Raises:
        UsageError: a mesh is not found or cannot be read.
    """
    root = ElementTree.fromstring(text)
    for element in root.iter():
        for child in list(element):
            if child.tag in ("visual", "transmission", "gazebo", "sensor"):
                element.remove(child)
    _drop_world(root)
    written: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if name not in written:
            written[name] = _write_hull(name, urdf, packages, directory, len(written))
        mesh.set("filename", written[name])
    path = directory / "robot.urdf"
    path.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    return path


def _drop_world(root: ElementTree.Element) -> None:
    for child in list(root):
        parent = child.find("parent")
        is_world_joint = child.tag == "joint" and parent is not None
        if is_world_joint and parent is not None and parent.get("link") == _WORLD:
            root.remove(child)
        if child.tag == "link" and child.get("name") == _WORLD:
            root.remove(child)


def _write_hull(
    name: str, urdf: Path, packages: Mapping[str, str], directory: Path, number: int
) -> str:
    try:
        source = find_mesh(name, urdf, packages, urdf.parent)
    except UrdfFault as fault:
        raise UsageError(
            f"--engine drake: {fault.message}; give the robot's file with --urdf FILE"
        ) from fault
    try:
        mesh = trimesh.load_mesh(source)
        hull = mesh.convex_hull
    except Exception as error:  # trimesh and its readers have no exception of their own
        raise UsageError(f"--engine drake: {source} cannot be read as a mesh: {error}") from error
    target = directory / f"mesh_{number}.obj"
    hull.export(target)
    return str(target.resolve())
