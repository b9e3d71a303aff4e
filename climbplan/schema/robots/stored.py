"""Robots as plan files keep them: the texts of the files that a spec names.

A plan goes where its spec's files do not, and must be verified there. A built-in robot is known by
its name; of any other the plan carries the text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.document import Document, KeyPath
from climbplan.schema.kinds import validate
from climbplan.schema.robots.source import AnyRobot, UnknownRobot, build_robot, load_any_robot
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.source import read_source
from climbplan.schema.yaml_source import parse_yaml

_NO_MESHES = {"limb_radius": 0.02, "body_half_size": (0.1, 0.1, 0.1)}  # in place of what meshes say
_BY_MESHES = {
    "limb_radius": ("limb_radius", "capsules", "touching"),
    "body_half_size": ("body_hull", "body_parts", "touching"),
}


@dataclass(frozen=True)
class RobotTexts:
    """What a plan carries of the files that a robot comes from; empty for a built-in robot."""

    yaml: str = ""  # the robot file that the spec names
    urdf: str = ""  # the URDF that the spec or the robot file names


@dataclass(frozen=True)
class StoredRobot:
    """A robot from texts, and the fields of it that only meshes, which no plan carries, tell."""

    robot: AnyRobot
    unknown: tuple[str, ...] = ()

    def with_mesh_fields(self, fields: Mapping[str, Any]) -> AnyRobot:
        """Return the robot with what meshes tell of it; raises NotKept if a field is missing.

        Args:
            fields: By name, as the plan has them; others are ignored.
        """
        if missing := [name for name in self.unknown if name not in fields]:
            raise NotKept(f"the plan does not carry the meshes that tell {missing[0]}")
        if not isinstance(self.robot, UrdfRobot):
            return self.robot
        return replace(self.robot, mesh_fields={name: fields[name] for name in self.unknown})


@dataclass(frozen=True)
class CarriedRobot:
    """A robot as a plan carries it, from which the rest of the plan is planned anew."""

    texts: RobotTexts
    # Fields of the built robot by name, of which those that only meshes tell are taken
    fields: Mapping[str, Any] = field(repr=False, compare=False)

    def load(self, document: Document) -> AnyRobot:
        """Return the robot of the plan's parsed spec.

        Raises:
            NotKept: The robot is neither built-in nor carried, or a field is missing.
            SpecError: A text is no robot.
        """
        return build_stored_robot(document, self.texts).with_mesh_fields(self.fields)


class NotKept(Exception):
    """A robot that neither the package nor the plan has; says so in words."""


def collect_robot_texts(
    reference: str | UrdfRobotSpec, directory: Path, robot: AnyRobot
) -> RobotTexts:
    """Return the texts of the files from which `robot` was loaded, for its plan.

    Args:
        reference: Value of `robot` in the spec: a built-in name, a path, or a URDF section.
        directory: Directory that a path starts from.
        robot: The loaded robot.

    Raises:
        SpecError: the file is no longer there.
    """
    named = isinstance(reference, str) and _is_path(reference)
    return RobotTexts(
        yaml=read_source(directory / str(reference)).text if named else "",
        urdf=robot.tree.text if isinstance(robot, UrdfRobot) else "",
    )


def build_stored_robot(document: Document, texts: RobotTexts) -> StoredRobot:
    """Return the robot of a plan's spec, built-in or from the texts that the plan carries.

    Args:
        document: The parsed spec of the plan.
        texts: Robot files that the plan carries.

    Raises:
        NotKept: The robot is neither built-in nor carried by the plan.
        SpecError: A text is no robot.
    """
    reference = document.value.get("robot") if isinstance(document.value, dict) else None
    if isinstance(reference, dict):
        return _build_from_urdf(document, ("robot",), texts.urdf)
    name = str(reference)
    if not _is_path(name):
        try:
            return StoredRobot(load_any_robot(name))
        except UnknownRobot:
            raise NotKept(f"{name!r} is no built-in robot") from None
    if not texts.yaml:
        raise NotKept(f"the plan does not carry {name}")
    robot_document = parse_yaml(texts.yaml, f"robot {name}")
    if isinstance(robot_document.value, dict) and "urdf" in robot_document.value:
        return _build_from_urdf(robot_document, (), texts.urdf)
    return StoredRobot(build_robot(robot_document, Path()))


def _build_from_urdf(document: Document, path: KeyPath, text: str) -> StoredRobot:
    """Return a robot section at `path`, with its URDF's text."""
    from climbplan.schema.robots.urdf.source import build_robot_from_tree
    from climbplan.schema.robots.urdf.tree import parse_urdf
    from climbplan.schema.robots.xml import UrdfFault, UrdfFaults

    if not text:
        raise NotKept("the plan does not carry its URDF")
    section = document.value["robot"] if path else document.value
    section_document = Document(document.source, document.text, section)
    spec, findings = validate(section_document, UrdfRobotSpec)
    robot: UrdfRobot | None = None
    unknown: tuple[str, ...] = ()
    if spec is not None:
        try:
            tree = parse_urdf(text, Path(spec.urdf))
        except (UrdfFault, UrdfFaults) as error:
            raise SpecError(spec.urdf, [SpecMistake("", str(error))]) from error
        if any(link.collision_meshes for link in tree.links.values()):
            unknown = tuple(name for name in _NO_MESHES if vars(spec)[name] is None)
            spec = spec.model_copy(update={name: _NO_MESHES[name] for name in unknown})
        robot, findings = build_robot_from_tree(spec, document, path, Path(), tree)
    if robot is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return StoredRobot(
        replace(robot, is_stored=True),
        tuple(dict.fromkeys(field_name for name in unknown for field_name in _BY_MESHES[name])),
    )


def _is_path(reference: str) -> bool:
    return Path(reference).suffix in (".yaml", ".yml")
