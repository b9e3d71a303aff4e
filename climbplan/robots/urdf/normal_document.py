"""The URDF that Pinocchio is given: what planning has read and checked, written anew.

Pinocchio's reader leaves out a mass or a shape whose number has a space behind it, and refuses
tabs between numbers. It is therefore never handed a user's text: only the elements that planning
looks at, with each number as Python prints it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

from climbplan.schema.robots.urdf.meshes import mesh_path, y_is_up
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.xml import Element, number_of, parsed, vector_of


@dataclass(frozen=True)
class _Kept:
    """What is kept of an element."""

    children: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    vectors: tuple[str, ...] = ()
    zero: tuple[str, ...] = ()  # numbers that have to be there, zero where they are left out


_KEPT = {
    "robot": _Kept(("link", "joint"), ("name",)),
    "link": _Kept(("inertial", "collision"), ("name",)),
    "inertial": _Kept(("origin", "mass", "inertia")),
    "mass": _Kept(numbers=("value",)),
    "inertia": _Kept(numbers=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "origin": _Kept(vectors=("xyz", "rpy")),
    "collision": _Kept(("origin", "geometry")),
    "visual": _Kept(("origin", "geometry")),
    "geometry": _Kept(("box", "cylinder", "capsule", "sphere", "mesh")),
    "box": _Kept(vectors=("size",)),
    "cylinder": _Kept(numbers=("radius", "length")),
    "capsule": _Kept(numbers=("radius", "length")),
    "sphere": _Kept(numbers=("radius",)),
    "mesh": _Kept(texts=("filename",), vectors=("scale",)),
    "joint": _Kept(("origin", "parent", "child", "axis", "limit"), ("name", "type")),
    "parent": _Kept(texts=("link",)),
    "child": _Kept(texts=("link",)),
    "axis": _Kept(vectors=("xyz",)),
    "limit": _Kept(numbers=("lower", "upper"), zero=("effort", "velocity")),
}
_LIMITED = ("revolute", "prismatic")  # joints that Pinocchio does not read without <limit>
_PICTURED = _KEPT | {"link": _Kept(("inertial", "visual"), ("name",))}
_SHAPES = ("collision", "visual")
_CAPSULE = "capsule"  # name of the shapes that are one
_MANY = ("link", "joint", *_SHAPES)  # of all others the first one counts


def normal_document(robot: UrdfRobot) -> str:
    """The text for Pinocchio, every collision mesh named by its file.

    Without meshes that are not looked at, and what carries no mass and has no part in a collision:
    pictures, transmissions, dampers.
    """
    root = parsed(robot.tree.text)
    root.attributes["name"] = robot.tree.name
    meshes = {name: str(path) for name, path in robot.meshes.items()}
    _upright(root, meshes)
    return _written(root, meshes, _KEPT)


def visual_document(robot: UrdfRobot) -> str:
    """The text with visual geometry in place of collision geometry.

    Raises UrdfFault for a mesh that is not there, and for numbers that are none.
    """
    root = parsed(robot.tree.text)
    root.attributes["name"] = robot.tree.name
    meshes = {
        mesh.attributes["filename"]: mesh
        for link in root.all("link")
        for visual in link.all("visual")
        if (geometry := visual.first("geometry")) is not None
        if (mesh := geometry.first("mesh")) is not None and "filename" in mesh.attributes
    }
    found = {
        name: str(mesh_path(name, robot.tree.path, robot.spec.packages, robot.directory))
        for name in meshes
    }
    _upright(root, found)
    return _written(root, found, _PICTURED)


def _upright(root: Element, meshes: dict[str, str]) -> None:
    """Turn meshes whose file says that y is up (COLLADA): Pinocchio takes their axes as they are.

    A further turn about x by 90 degrees is one more of the first of three about fixed axes.
    """
    turned = {name for name, path in meshes.items() if y_is_up(Path(path))}
    for shape in root.walk() if turned else ():
        geometry = shape.first("geometry") if shape.tag in _SHAPES else None
        mesh = None if geometry is None else geometry.first("mesh")
        if mesh is None or mesh.attributes.get("filename") not in turned:
            continue
        origin = shape.first("origin")
        if origin is None:
            origin = Element("origin", {}, shape.line)
            shape.children.append(origin)
        roll, pitch, yaw = vector_of(origin, "rpy") or (0.0, 0.0, 0.0)
        origin.attributes["rpy"] = f"{roll + 0.5 * math.pi!r} {pitch!r} {yaw!r}"


def _written(element: Element, meshes: dict[str, str], tags: dict[str, _Kept]) -> str:
    kept = tags[element.tag]
    texts = {name: element.attributes[name] for name in kept.texts if name in element.attributes}
    if element.tag == "mesh":
        texts["filename"] = meshes[texts["filename"]]
    for name in (*kept.numbers, *kept.zero):
        number = number_of(element, name)
        if number is not None or name in kept.zero:
            texts[name] = repr(number or 0.0)
    for name in kept.vectors:
        vector = vector_of(element, name)
        if vector is not None:
            texts[name] = " ".join(repr(value) for value in vector)
    head = " ".join([element.tag, *(f"{name}={quoteattr(text)}" for name, text in texts.items())])
    children = _children(element, kept, meshes)
    below = "".join(_written(child, meshes, tags) for child in children)
    if element.tag == "capsule":
        return _written(replace(element, tag="cylinder"), meshes, tags)
    if element.tag == "link":
        below += _capsules(children)
    if element.tag in _SHAPES and _is_capsule(element):
        head += f" name={quoteattr(_CAPSULE)}"
    return f"<{head}>{below}</{element.tag}>\n"


def _capsules(children: list[Element]) -> str:
    """What tells Pinocchio that shapes of a link are capsules: its reader knows no such shape.

    It takes cylinders of that name for the middle of a capsule.
    """
    if not any(child.tag in _SHAPES and _is_capsule(child) for child in children):
        return ""
    return f"<collision_checking><capsule name={quoteattr(_CAPSULE)}/></collision_checking>\n"


def _is_capsule(shape: Element) -> bool:
    geometry = shape.first("geometry")
    return geometry is not None and geometry.first("capsule") is not None


def _children(element: Element, kept: _Kept, meshes: dict[str, str]) -> list[Element]:
    found = []
    for tag in kept.children:
        own = element.all(tag)
        found += own if tag in _MANY else own[:1]
    if element.tag == "joint" and element.attributes.get("type") in _LIMITED:
        limits = element.first("limit") or Element("limit", {}, element.line)
        found = [*(child for child in found if child.tag != "limit"), limits]
    if element.tag == "link":
        found = [child for child in found if child.tag not in _SHAPES or _is_seen(child, meshes)]
    return found


def _is_seen(shape: Element, meshes: dict[str, str]) -> bool:
    geometry = shape.first("geometry")
    mesh = None if geometry is None else geometry.first("mesh")
    return mesh is None or mesh.attributes.get("filename") in meshes
