"""Where the meshes of a URDF are: `package://`, `file://`, relative and absolute."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlparse

from climbplan.schema.robots.xml import UrdfFault

_PACKAGE = "package://"
_SHARE = "share"  # folder of packages where ROS installs them
_HEAD = 65_536  # [bytes] of a mesh file that has its <asset>
_AXIS = 16  # [bytes] behind the tag


def find_mesh(name: str, urdf: Path, packages: Mapping[str, str], directory: Path) -> Path:
    """Return the file of a mesh that a URDF names.

    Args:
        name: As the URDF has it: `package://`, `file://` or a path from the URDF.
        urdf: Path of the URDF.
        packages: Package name -> directory, relative to `directory`. Others are looked for in
            directories above the URDF and in ROS_PACKAGE_PATH, and the end of a path last in
            directories above the URDF.
        directory: Directory of the robot file.

    Raises:
        UrdfFault: The name has another form, or there is no such file.
    """
    if name.startswith(_PACKAGE):
        package, _, inner_path = name.removeprefix(_PACKAGE).partition("/")
        try:
            path = _find_package(package, urdf, packages, directory) / inner_path
        except UrdfFault:
            path_above = _find_above(Path(inner_path).parts, urdf)
            if path_above is None:
                raise
            path = path_above
    elif name.startswith("file://"):
        path = Path(unquote(urlparse(name).path))
        if not path.is_file():
            path = _find_installed(path, urdf, packages, directory) or path
    elif "://" in name:
        raise UrdfFault(f"mesh {name!r}: expected package://, file:// or a path")
    else:
        path = urdf.parent / name  # an absolute path stays what it is
    if not path.is_file():
        raise UrdfFault(f"mesh {name!r} not found: no file {path}")
    return path.resolve()


def _find_installed(
    path: Path, urdf: Path, packages: Mapping[str, str], directory: Path
) -> Path | None:
    """Return the file of a mesh that was at an absolute path on another machine; None without one.

    Behind `share` stands the name of a package, as where ROS installs it. Other paths are looked
    for by their ends. Arguments are those of `find_mesh`.
    """
    components = path.parts
    if _SHARE in components[:-2]:
        package, *inner = components[components.index(_SHARE) + 1 :]
        try:
            installed = _find_package(package, urdf, packages, directory).joinpath(*inner)
        except UrdfFault:
            installed = None
        if installed is not None and installed.is_file():
            return installed
    return _find_above(components[1:], urdf)


def _find_above(components: tuple[str, ...], urdf: Path) -> Path | None:
    """Return the file in a directory above a URDF whose path ends with most given components.

    A folder and a file name have to agree at least. None without one.
    """
    for start in range(len(components) - 1):
        for parent in urdf.resolve().parents:
            path = parent.joinpath(*components[start:])
            if path.is_file():
                return path
    return None


@cache
def is_y_up(path: Path) -> bool:
    """Return whether a mesh file says that its y points up: `<up_axis>` of COLLADA.

    Where that is left out z is up, as in all other meshes of URDFs.
    """
    if path.suffix.lower() != ".dae":
        return False
    try:
        with path.open("rb") as stream:
            return b"Y_UP" in stream.read(_HEAD).partition(b"<up_axis>")[2][:_AXIS]
    except OSError:
        return False


def _find_package(name: str, urdf: Path, packages: Mapping[str, str], directory: Path) -> Path:
    if name in packages:
        path = directory / packages[name]
        if not path.is_dir():
            raise UrdfFault(f"package {name!r}: no directory {path}")
        return path
    above = urdf.resolve().parents
    listed = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    for parent in above:
        if parent.name == name:
            return parent
    for parent in (*above, *listed):
        for place in (parent, parent / name):
            if place.name == name and place.is_dir():
                return place
    raise UrdfFault(
        f"package {name!r} not found above {urdf.parent} or in ROS_PACKAGE_PATH; expected "
        f"`packages: {{{name}: DIRECTORY}}`"
    )
