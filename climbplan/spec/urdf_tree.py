"""The links and joints of a URDF, each with the line it stands in.

Only what the text says: nothing is run, no entity is expanded and no other file is opened.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from climbplan.errors import ClimbplanError

LARGEST_URDF = 20_000_000  # [bytes]
_DEEPEST = 200
TURNING = ("revolute", "continuous")


class UrdfFault(ClimbplanError):
    """A text that is no URDF; `line` is where, None for the whole."""

    def __init__(self, message: str, line: int | None = None) -> None:
        self.message = message
        self.line = line
        super().__init__(message)


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as it is written."""

    name: str
    line: int
    kind: str
    parent: str
    child: str
    lower: float  # [rad], -inf if there is none
    upper: float
    effort: float | None  # [N m], None if not given
    velocity: float | None  # [rad/s]
    mimics: str | None

    @property
    def turns(self) -> bool:
        """Whether it is a joint that a leg may have."""
        return self.kind in TURNING


@dataclass(frozen=True)
class UrdfLink:
    """One link as it is written."""

    name: str
    line: int
    mass: float  # [kg], 0 if there is none
    collision_meshes: tuple[tuple[str, int], ...]  # file names and their lines
    has_collision: bool


@dataclass(frozen=True)
class UrdfTree:
    """All of a URDF that planning looks at."""

    path: Path
    text: str = field(repr=False)
    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]

    @property
    def by_child(self) -> dict[str, UrdfJoint]:
        """The joint that carries each link (the last one, should there be several)."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def roots(self) -> list[str]:
        """Links that no joint carries."""
        carried = self.by_child
        return [name for name in self.links if name not in carried]

    def at(self, line: int) -> str:
        """Where something is written: `robot.urdf line 12`."""
        return f"{self.path.name} line {line}"

    def way_to(self, link: str, base: str) -> list[UrdfJoint] | None:
        """Joints from `base` to `link`, None if they are not connected that way."""
        carried, here = self.by_child, link
        way: list[UrdfJoint] = []
        while here != base:
            joint = carried.get(here)
            if joint is None or len(way) > len(self.joints):
                return None
            way.append(joint)
            here = joint.parent
        return way[::-1]


Entry = TypeVar("Entry", UrdfLink, UrdfJoint)


@dataclass
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)

    def first(self, tag: str) -> _Element | None:
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> list[_Element]:
        return [c for c in self.children if c.tag == tag]


def read_urdf(path: Path) -> UrdfTree:
    """The tree of a URDF file.

    Raises UrdfFault for a file that is missing, too large, no XML, or no URDF.
    """
    try:
        if path.is_dir():
            raise UrdfFault("a directory, expected a URDF file")
        with path.open("rb") as stream:
            content = stream.read(LARGEST_URDF + 1)
    except FileNotFoundError:
        raise UrdfFault(f"no such file: {path}") from None
    except (OSError, ValueError) as error:
        raise UrdfFault(f"{path}: cannot be read: {error}") from error
    if len(content) > LARGEST_URDF:
        raise UrdfFault(f"too large, a URDF has {LARGEST_URDF / 1e6:.0f} MB at most")
    root = _parsed(content)
    if root.tag != "robot":
        raise UrdfFault(f"expected <robot> as the first element, got <{root.tag}>", root.line)
    if path.suffix == ".xacro" or b"xmlns:xacro" in content:
        raise UrdfFault(f"a xacro; write its URDF first: xacro {path.name} > {path.stem}.urdf")
    links = _named([_link(e) for e in root.all("link")], "link")
    joints = _named([_joint(e) for e in root.all("joint")], "joint")
    if not links:
        raise UrdfFault("no <link> in it")
    for joint in joints.values():
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise UrdfFault(f"{role} of joint {joint.name!r} is no link: {name!r}", joint.line)
    name = root.attributes.get("name", "") or path.stem
    return UrdfTree(path, content.decode("utf-8", "replace"), name, links, joints)


def _parsed(content: bytes) -> _Element:
    parser = xml.parsers.expat.ParserCreate()
    stack: list[_Element] = []
    roots: list[_Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Element(tag, attributes, parser.CurrentLineNumber)
        if len(stack) >= _DEEPEST:
            raise UrdfFault(f"elements nested more than {_DEEPEST} deep", element.line)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(tag: str) -> None:
        stack.pop()

    def entity(*_: object) -> None:
        raise UrdfFault("declares XML entities, which a URDF has no need of")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(content, True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise UrdfFault(f"not XML: {reason}", error.lineno) from error
    return roots[0]


def _named(entries: list[Entry], what: str) -> dict[str, Entry]:
    out: dict[str, Entry] = {}
    for entry in entries:
        if entry.name in out:
            raise UrdfFault(f"two {what}s are named {entry.name!r}", entry.line)
        out[entry.name] = entry
    return out


def _text(element: _Element, name: str) -> str:
    value = element.attributes.get(name, "")
    if not value:
        raise UrdfFault(f"<{element.tag}> without `{name}`", element.line)
    return value


def _number(element: _Element | None, name: str) -> float | None:
    if element is None or name not in element.attributes:
        return None
    text = element.attributes[name]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UrdfFault(
            f"`{name}` of <{element.tag}>: expected a number, got {text[:40]!r}", element.line
        )
    return value


def _link(element: _Element) -> UrdfLink:
    inertial = element.first("inertial")
    mass = _number(inertial.first("mass"), "value") if inertial is not None else None
    collisions = element.all("collision")
    meshes = [
        (_text(mesh, "filename"), mesh.line)
        for collision in collisions
        for geometry in collision.all("geometry")
        for mesh in geometry.all("mesh")
    ]
    return UrdfLink(
        _text(element, "name"), element.line, mass or 0.0, tuple(meshes), bool(collisions)
    )


def _joint(element: _Element) -> UrdfJoint:
    name, kind = _text(element, "name"), _text(element, "type")
    ends = []
    for role in ("parent", "child"):
        holder = element.first(role)
        if holder is None:
            raise UrdfFault(f"joint {name!r} has no <{role}>", element.line)
        ends.append(_text(holder, "link"))
    limit, mimic = element.first("limit"), element.first("mimic")
    lower, upper = -math.inf, math.inf
    if kind == "revolute":
        lower, upper = _number(limit, "lower") or 0.0, _number(limit, "upper") or 0.0
    return UrdfJoint(
        name=name,
        line=element.line,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        lower=lower,
        upper=upper,
        effort=_number(limit, "effort"),
        velocity=_number(limit, "velocity"),
        mimics=None if mimic is None else _text(mimic, "joint"),
    )
