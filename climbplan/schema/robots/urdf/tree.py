"""The links and joints of a URDF, each with the line it stands in, and nothing but numbers in them.

Pinocchio leaves out what it cannot read (a shape, a mass) with no more than a line on the terminal:
all that counts for planning is looked at here first.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from climbplan.schema.robots.ranges import ANGLE, LENGTH, MASS, PLACE
from climbplan.schema.robots.urdf.encoding import decode_xml
from climbplan.schema.robots.xml import (
    Element,
    UrdfFault,
    UrdfFaults,
    parse_xml,
    read_number_attribute,
    read_text_attribute,
    read_vector_attribute,
)

_NAMESPACE = re.compile(r"https?://(www\.)?(wiki\.)?ros\.org/(wiki/)?xacro/?")
_TO_EXPAND = re.compile(r"\$[{(]")
_ENDINGS = (".xacro", ".urdf", ".xml")
_MAX_PARSED = 4  # texts whose elements are remembered


def reject_xacro(root: Element, path: Path) -> None:
    """Raise UrdfFault where an element or a `${...}` is left for xacro.

    A file that only names xacro's namespace, as what xacro writes does, has nothing left.
    """
    prefixes = {"xacro"} | {
        name.removeprefix("xmlns:")
        for element in root.walk()
        for name, value in element.attributes.items()
        if name.startswith("xmlns:") and _NAMESPACE.fullmatch(value.strip())
    }
    for element in root.walk():
        prefix, colon, _ = element.tag.partition(":")
        if colon and prefix in prefixes:
            raise _report_xacro(f"<{element.tag}>", element, path)
    # Parts of other programs (<gazebo>, <transmission>) may hold a `$(...)` of their own
    for section in (root, *(c for c in root.children if c.tag in ("link", "joint"))):
        for element in [root] if section is root else section.walk():
            for value in element.attributes.values():
                if _TO_EXPAND.search(value):
                    raise _report_xacro(repr(value[:40]), element, path)


def _report_xacro(what: str, element: Element, path: Path) -> UrdfFault:
    output = _choose_output_path(path)
    command = f"xacro {shlex.quote(str(path))} > {shlex.quote(str(output))}"
    return UrdfFault(
        f"{what} is left for xacro to expand; make the URDF with `{command}` and name that",
        element.line,
    )


def _choose_output_path(path: Path) -> Path:
    """Return where to write the URDF to: never over the file itself nor over another one."""
    stem = path.name
    while stem.endswith(_ENDINGS) and Path(stem).stem:
        stem = Path(stem).stem
    names = [f"{stem}.urdf", f"{stem}_expanded.urdf"]
    names += [f"{stem}_expanded_{number}.urdf" for number in range(2, 100)]
    input_name = path.name.lower()
    candidates = (path.with_name(name) for name in names if name.lower() != input_name)
    return next(
        (candidate for candidate in candidates if not candidate.exists()), path.with_name(names[-1])
    )


LARGEST_URDF = 20_000_000  # [bytes]
TURNING = ("revolute", "continuous")
SLIDING = "prismatic"
_KINDS = (*TURNING, SLIDING, "fixed", "floating", "planar")
_NO_SDF = (
    "an SDF file, which Pinocchio reads only where it is built with sdformat, as none of the "
    "packages on PyPI is; expected a URDF or an MJCF file"
)
_SHORTEST = 1e-6  # of an axis
_LARGEST_SCALE = 1e6  # of a mesh
_LARGEST_DYNAMICS = 1e7  # of damping, friction and armature
# Sizes that each shape has to have
_SHAPES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),  # length without the round ends
    "sphere": ("radius",),
    "mesh": (),
}


@dataclass(frozen=True)
class Mimic:
    """That a joint follows another one: multiplier times that one's place, plus offset."""

    joint: str
    multiplier: float
    offset: float  # [rad], [m] of a joint that slides


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as it is written."""

    name: str
    line: int
    kind: str
    parent: str
    child: str
    lower: float  # [rad], [m] of one that slides; -inf if there is none
    upper: float
    effort: float | None  # [N m], [N]; None if not given
    velocity: float | None  # [rad/s], [m/s]
    mimic: Mimic | None
    damping: float = 0.0  # [N m s/rad], [N s/m], viscous
    friction: float = 0.0  # [N m], [N], dry
    armature: float | None = None  # [kg m^2], [kg], of an MJCF file; None if not given

    @property
    def mimics(self) -> str | None:
        """The joint that it follows."""
        return None if self.mimic is None else self.mimic.joint

    @property
    def turns(self) -> bool:
        """Return whether it turns about its axis."""
        return self.kind in TURNING

    @property
    def slides(self) -> bool:
        """Return whether it slides along its axis."""
        return self.kind == SLIDING

    @property
    def moves(self) -> bool:
        """Return whether it is a joint that a leg may have."""
        return self.turns or self.slides


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

    @property
    def moving_mass(self) -> dict[str, float]:
        """Mass [kg] of each link that a joint moves, with all that is fixed to it."""
        carried = self.by_child
        mass = {joint.child: 0.0 for joint in self.joints.values() if joint.kind != "fixed"}
        for link in self.links.values():
            name = link.name
            while name in carried and carried[name].kind == "fixed":
                name = carried[name].parent
            if name in mass:
                mass[name] += link.mass
        return mass

    def format_location(self, line: int) -> str:
        """Return where something is written: `robot.urdf line 12`."""
        return f"{self.path.name} line {line}"

    def way_to(self, link: str, base: str) -> list[UrdfJoint] | None:
        """Return joints from `base` to `link`, None if they are not connected that way."""
        carried, link_name = self.by_child, link
        chain: list[UrdfJoint] = []
        while link_name != base:
            joint = carried.get(link_name)
            if joint is None or len(chain) > len(self.joints):
                return None
            chain.append(joint)
            link_name = joint.parent
        return chain[::-1]


Entry = TypeVar("Entry", UrdfLink, UrdfJoint)


def read_urdf(path: Path) -> UrdfTree:
    """Return the tree of a URDF file, or of an MJCF file, which is written as URDF first.

    Raises UrdfFault for a file that is missing, too large or neither, UrdfFaults with all that is
    wrong in one, and MissingSolver for an MJCF file without MuJoCo.
    """
    from climbplan.schema.robots.mjcf.as_urdf import convert_mjcf_to_urdf

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
    text = decode_xml(content)
    tag, line = _read_root_tag(text)
    if tag == "mujoco":
        text = convert_mjcf_to_urdf(path, parse_xml(text))
    elif tag == "sdf":
        raise UrdfFault(_NO_SDF, line)
    return parse_urdf(text, path)


@lru_cache(maxsize=_MAX_PARSED)
def _read_root_tag(text: str) -> tuple[str, int | None]:
    """Return the tag of the first element of an XML text, and its line."""
    root = parse_xml(text)
    return root.tag, root.line


@lru_cache(maxsize=_MAX_PARSED)
def parse_urdf(text: str, path: Path) -> UrdfTree:
    """Return the tree of a URDF's text, which texts that are parsed again share.

    Args:
        text: XML of the URDF.
        path: File that it is from, for messages and mesh paths.

    Raises:
        UrdfFault: It is no URDF.
        UrdfFaults: With all that is wrong in one.
    """
    root = parse_xml(text)
    if root.tag != "robot":
        expected = "expected <robot>, or <mujoco> of an MJCF file,"
        raise UrdfFault(f"{expected} as the first element, got <{root.tag}>", root.line)
    reject_xacro(root, path)
    for element in root.walk():
        element.line = int(read_number_attribute(element, "from_line") or element.line)
    faults: list[UrdfFault] = []
    links = _index_by_name(_read_entries(_read_link, root.all("link"), faults), "link", faults)
    joints = _index_by_name(_read_entries(_read_joint, root.all("joint"), faults), "joint", faults)
    if not root.all("link"):
        faults.append(UrdfFault("no <link> in it"))
    link_names = {element.attributes.get("name") for element in root.all("link")}
    faults += [
        UrdfFault(f"{role} of joint {joint.name!r} is no link: {name!r}", joint.line)
        for joint in joints.values()
        for role, name in (("parent", joint.parent), ("child", joint.child))
        if name not in link_names
    ]
    if faults:
        raise UrdfFaults(sorted(faults, key=lambda fault: fault.line or 0))
    name = root.attributes.get("name", "") or path.stem
    return UrdfTree(path, text, name, links, joints)


def _read_entries(
    reader: Callable[[Element], Entry], elements: list[Element], faults: list[UrdfFault]
) -> list[Entry]:
    out = []
    for element in elements:
        try:
            out.append(reader(element))
        except UrdfFault as fault:
            faults.append(fault)
    return out


def _index_by_name(entries: list[Entry], what: str, faults: list[UrdfFault]) -> dict[str, Entry]:
    out: dict[str, Entry] = {}
    for entry in entries:
        if entry.name in out:
            faults.append(UrdfFault(f"two {what}s are named {entry.name!r}", entry.line))
        out[entry.name] = entry
    return out


def _read_link(element: Element) -> UrdfLink:
    inertial = element.first("inertial")
    mass = 0.0
    if inertial is not None:
        stated_mass = read_number_attribute(inertial.first("mass"), "value")
        if stated_mass is None or inertial.first("inertia") is None:
            raise UrdfFault("<inertial> without <mass value=...> or <inertia>", inertial.line)
        if stated_mass > MASS.high:  # links may be as light as nothing
            message = f"<mass>: expected {MASS.high:g} kg at most, got {stated_mass:g}"
            raise UrdfFault(message, inertial.line)
        mass = stated_mass
        _check_inertia(inertial.first("inertia"))
        _check_origin(inertial)
    meshes = []
    for collision in element.all("collision"):
        _check_origin(collision)
        shape = _read_shape(collision)
        if shape.tag == "mesh":
            meshes.append((read_text_attribute(shape, "filename"), shape.line))
    collides = bool(element.all("collision"))
    return UrdfLink(
        read_text_attribute(element, "name"), element.line, mass, tuple(meshes), collides
    )


def _check_inertia(element: Element | None) -> None:
    """Refuse moments of inertia that are missing or no numbers: Pinocchio would drop them all."""
    if element is None:
        return
    for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        if read_number_attribute(element, name) is None:
            raise UrdfFault(f"<inertia> without `{name}`", element.line)


def _check_origin(holder: Element) -> None:
    """Refuse a place that is not three numbers each, or one out of this world."""
    for origin in holder.all("origin"):
        for name, allowed in (("xyz", PLACE), ("rpy", ANGLE)):
            values = read_vector_attribute(origin, name) or (0.0, 0.0, 0.0)
            if not all(allowed.holds(value) for value in values):
                text = " ".join(f"{value:g}" for value in values)
                message = f"`{name}` of <origin>: expected {allowed.expected}, got {text}"
                raise UrdfFault(message, origin.line)


def _read_shape(collision: Element) -> Element:
    """Return the one shape of a <collision>."""
    geometry = collision.first("geometry")
    shapes = [] if geometry is None else geometry.children
    if len(shapes) != 1 or shapes[0].tag not in _SHAPES:
        text = ", ".join(f"<{shape.tag}>" for shape in shapes) or "none"
        raise UrdfFault(
            f"<collision> with one shape expected, {', '.join(_SHAPES)}; got {text}", collision.line
        )
    shape = shapes[0]
    scale = read_vector_attribute(shape, "scale") if shape.tag == "mesh" else None
    if scale is not None and not all(0 < abs(factor) <= _LARGEST_SCALE for factor in scale):
        text = " ".join(f"{factor:g}" for factor in scale)
        expected = f"three numbers up to {_LARGEST_SCALE:g}, none of them zero"
        raise UrdfFault(f"`scale` of <mesh>: expected {expected}, got {text}", shape.line)
    for name in _SHAPES[shape.tag]:
        sizes = (
            read_vector_attribute(shape, name)
            if name == "size"
            else (read_number_attribute(shape, name) or 0.0,)
        )
        if sizes is None or min(sizes) <= 0:
            raise UrdfFault(f"<{shape.tag}>: expected `{name}` > 0", shape.line)
        if max(sizes) > LENGTH.high:
            largest = f"`{name}` up to {LENGTH.high:g} m, got {max(sizes):g}"
            raise UrdfFault(f"<{shape.tag}>: expected {largest}", shape.line)
    return shape


def _read_joint(element: Element) -> UrdfJoint:
    name, kind = read_text_attribute(element, "name"), read_text_attribute(element, "type")
    ends = []
    for role in ("parent", "child"):
        holder = element.first(role)
        if holder is None:
            raise UrdfFault(f"joint {name!r} has no <{role}>", element.line)
        ends.append(read_text_attribute(holder, "link"))
    if kind not in _KINDS:
        expected = ", ".join(_KINDS)
        raise UrdfFault(f"joint {name!r} has the type {kind!r}, expected {expected}", element.line)
    _check_origin(element)
    axis = element.first("axis")
    if kind not in ("fixed", "floating") and axis is not None:
        direction = read_vector_attribute(axis, "xyz") or (0.0, 0.0, 0.0)
        if math.hypot(*direction) < _SHORTEST:
            raise UrdfFault(f"joint {name!r}: expected an axis of some length", axis.line)
    limit, mimic = element.first("limit"), element.first("mimic")
    lower, upper = -math.inf, math.inf
    if kind in ("revolute", SLIDING):
        lower, upper = (
            read_number_attribute(limit, "lower") or 0.0,
            read_number_attribute(limit, "upper") or 0.0,
        )
    dynamics = element.first("dynamics")
    for attribute in ("damping", "friction", "armature"):
        stated = read_number_attribute(dynamics, attribute) or 0.0
        if not 0 <= stated <= _LARGEST_DYNAMICS:
            message = f"<dynamics {attribute}> of joint {name!r}: expected 0 to "
            line = element.line if dynamics is None else dynamics.line
            raise UrdfFault(f"{message}{_LARGEST_DYNAMICS:g}, got {stated:g}", line)
    return UrdfJoint(
        name=name,
        line=element.line,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        lower=lower,
        upper=upper,
        effort=read_number_attribute(limit, "effort"),
        velocity=read_number_attribute(limit, "velocity"),
        # A joint that does not move follows nothing: reduced models leave the element behind
        mimic=None if mimic is None or kind == "fixed" else _read_mimic(mimic),
        damping=read_number_attribute(dynamics, "damping") or 0.0,
        friction=read_number_attribute(dynamics, "friction") or 0.0,
        armature=read_number_attribute(dynamics, "armature") or None,
    )


def _read_mimic(element: Element) -> Mimic:
    multiplier = read_number_attribute(element, "multiplier")
    return Mimic(
        joint=read_text_attribute(element, "joint"),
        multiplier=1.0 if multiplier is None else multiplier,
        offset=read_number_attribute(element, "offset") or 0.0,
    )
