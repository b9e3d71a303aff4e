"""The canonical URDF that Pinocchio reads: only what planning has checked.

Pinocchio's reader ignores a mass or a shape whose number has a space behind it, and refuses tabs
between numbers. It therefore never reads a user's text. It gets only the elements that planning
looks at, with each number as Python prints it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from xml.sax.saxutils import quoteattr

from climbplan.schema.robots.urdf.meshes import find_mesh, is_y_up
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.xml import (
    Element,
    parse_xml,
    read_number_attribute,
    read_vector_attribute,
)


@dataclass(frozen=True)
class _ElementRule:
    """The children and attributes that an element keeps."""

    children: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    vectors: tuple[str, ...] = ()
    zero: tuple[str, ...] = ()  # required numbers, zero where they are left out


_RULES = {
    "robot": _ElementRule(("link", "joint"), ("name",)),
    "link": _ElementRule(("inertial", "collision"), ("name",)),
    "inertial": _ElementRule(("origin", "mass", "inertia")),
    "mass": _ElementRule(numbers=("value",)),
    "inertia": _ElementRule(numbers=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "origin": _ElementRule(vectors=("xyz", "rpy")),
    "collision": _ElementRule(("origin", "geometry")),
    "visual": _ElementRule(("origin", "geometry")),
    "geometry": _ElementRule(("box", "cylinder", "capsule", "sphere", "mesh")),
    "box": _ElementRule(vectors=("size",)),
    "cylinder": _ElementRule(numbers=("radius", "length")),
    "capsule": _ElementRule(numbers=("radius", "length")),
    "sphere": _ElementRule(numbers=("radius",)),
    "mesh": _ElementRule(texts=("filename",), vectors=("scale",)),
    "joint": _ElementRule(("origin", "parent", "child", "axis", "limit"), ("name", "type")),
    "parent": _ElementRule(texts=("link",)),
    "child": _ElementRule(texts=("link",)),
    "axis": _ElementRule(vectors=("xyz",)),
    "limit": _ElementRule(numbers=("lower", "upper"), zero=("effort", "velocity")),
}
_JOINTS_WITH_LIMITS = (
    "revolute",
    "prismatic",
)  # joints that Pinocchio does not read without <limit>
_VISUAL_RULES = _RULES | {"link": _ElementRule(("inertial", "visual"), ("name",))}
_SHAPES = ("collision", "visual")
_CAPSULE = "capsule"  # name of the shapes that are one
_CACHE_SIZE = 8  # texts that are remembered: a robot is built again for each plan
_REPEATED_TAGS = ("link", "joint", *_SHAPES)  # of all others the first one counts


def write_canonical_urdf(robot: UrdfRobot) -> str:
    """Return the text for Pinocchio with every collision mesh named by its file.

    Meshes that are not needed are left out, and so is all that has neither mass nor collisions:
    pictures, transmissions, dampers.
    """
    meshes = {name: str(path) for name, path in robot.meshes.items()}
    return _format_urdf(robot, meshes, is_visual=False)


def write_visual_urdf(robot: UrdfRobot) -> str:
    """Return the text with visual geometry in place of collision geometry.

    Raises:
        UrdfFault: A mesh does not exist, or a number cannot be read.
    """
    meshes = {
        name: str(find_mesh(name, robot.tree.path, robot.spec.packages, robot.directory))
        for name in _list_visual_meshes(robot.tree.text)
    }
    return _format_urdf(robot, meshes, is_visual=True)


@lru_cache(maxsize=_CACHE_SIZE)
def _list_visual_meshes(text: str) -> tuple[str, ...]:
    """Return the names of the visual meshes of a URDF's text."""
    names = [
        mesh.attributes["filename"]
        for link in parse_xml(text).all("link")
        for visual in link.all("visual")
        if (geometry := visual.first("geometry")) is not None
        if (mesh := geometry.first("mesh")) is not None and "filename" in mesh.attributes
    ]
    return tuple(dict.fromkeys(names))


def _format_urdf(robot: UrdfRobot, meshes: dict[str, str], *, is_visual: bool) -> str:
    """Return the text of a robot with its meshes by the paths of their files."""
    y_up = frozenset(name for name, path in meshes.items() if is_y_up(Path(path)))
    tree = robot.tree
    return _format_text(tree.text, tree.name, tuple(meshes.items()), y_up, is_visual)


@lru_cache(maxsize=_CACHE_SIZE)
def _format_text(
    text: str,
    name: str,
    meshes: tuple[tuple[str, str], ...],
    y_up: frozenset[str],
    is_visual: bool,
) -> str:
    """Return a URDF's text with a robot's name and the paths of meshes.

    y_up: meshes whose file says that y is up.
    """
    root = parse_xml(text)
    root.attributes["name"] = name
    _turn_meshes_upright(root, y_up)
    return _format_element(root, dict(meshes), _VISUAL_RULES if is_visual else _RULES)


def _turn_meshes_upright(root: Element, y_up: frozenset[str]) -> None:
    """Turn meshes whose file says that y is up (COLLADA), which Pinocchio does not turn.

    A further rotation about x by 90 degrees is one more of the first of three about fixed axes.
    """
    for shape in root.walk() if y_up else ():
        geometry = shape.first("geometry") if shape.tag in _SHAPES else None
        mesh = None if geometry is None else geometry.first("mesh")
        if mesh is None or mesh.attributes.get("filename") not in y_up:
            continue
        origin = shape.first("origin")
        if origin is None:
            origin = Element("origin", {}, shape.line)
            shape.children.append(origin)
        roll, pitch, yaw = read_vector_attribute(origin, "rpy") or (0.0, 0.0, 0.0)
        origin.attributes["rpy"] = f"{roll + 0.5 * math.pi!r} {pitch!r} {yaw!r}"


def _format_element(element: Element, meshes: dict[str, str], tags: dict[str, _ElementRule]) -> str:
    """Return the text of an element with what the rules keep of it.

    meshes: files of meshes by their names in the URDF.
    """
    rule = tags[element.tag]
    texts = {name: element.attributes[name] for name in rule.texts if name in element.attributes}
    if element.tag == "mesh":
        texts["filename"] = meshes[texts["filename"]]
    for name in (*rule.numbers, *rule.zero):
        number = read_number_attribute(element, name)
        if number is not None or name in rule.zero:
            texts[name] = repr(number or 0.0)
    for name in rule.vectors:
        vector = read_vector_attribute(element, name)
        if vector is not None:
            texts[name] = " ".join(repr(value) for value in vector)
    opening = " ".join(
        [element.tag, *(f"{name}={quoteattr(text)}" for name, text in texts.items())]
    )
    children = _select_children(element, rule, meshes)
    content = "".join(_format_element(child, meshes, tags) for child in children)
    if element.tag == "capsule":
        return _format_element(replace(element, tag="cylinder"), meshes, tags)
    if element.tag == "link":
        content += _format_capsule_hint(children)
    if element.tag in _SHAPES and _is_capsule(element):
        opening += f" name={quoteattr(_CAPSULE)}"
    return f"<{opening}>{content}</{element.tag}>\n"


def _format_capsule_hint(children: list[Element]) -> str:
    """Return the element that tells Pinocchio that shapes of a link are capsules; may be empty.

    Its reader knows no such shape, but takes cylinders of that name for the middle of a capsule.
    """
    if not any(child.tag in _SHAPES and _is_capsule(child) for child in children):
        return ""
    return f"<collision_checking><capsule name={quoteattr(_CAPSULE)}/></collision_checking>\n"


def _is_capsule(shape: Element) -> bool:
    """Return whether the geometry of a shape is a capsule."""
    geometry = shape.first("geometry")
    return geometry is not None and geometry.first("capsule") is not None


def _select_children(element: Element, rule: _ElementRule, meshes: dict[str, str]) -> list[Element]:
    """Return the children of an element that its rule keeps."""
    selected = []
    for tag in rule.children:
        same_tag = element.all(tag)
        selected += same_tag if tag in _REPEATED_TAGS else same_tag[:1]
    if element.tag == "joint" and element.attributes.get("type") in _JOINTS_WITH_LIMITS:
        limits = element.first("limit") or Element("limit", {}, element.line)
        selected = [*(child for child in selected if child.tag != "limit"), limits]
    if element.tag == "link":
        selected = [
            child for child in selected if child.tag not in _SHAPES or _is_readable(child, meshes)
        ]
    return selected


def _is_readable(shape: Element, meshes: dict[str, str]) -> bool:
    """Return whether a shape is no mesh, or a mesh with a file."""
    geometry = shape.first("geometry")
    mesh = None if geometry is None else geometry.first("mesh")
    return mesh is None or mesh.attributes.get("filename") in meshes
