"""Robots by built-in name or by path, with mistakes at the robot file's own lines."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import find_kind, validate
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml

AnyRobot = RobotSpec | UrdfRobot
NO_CHAINS = "expected limbs of coxa, femur and tibia, not a robot from a URDF"
URDF_HINT = "; a URDF needs to be told its legs: `robot: {urdf: PATH, legs: {NAME: {toe: LINK}}}`"
NEW_ROBOT_HINT = "; `climbplan new robot --urdf FILE` makes a robot file from a URDF"


class UnknownRobot(ValueError):
    """Neither a built-in robot nor a robot file; `suggestion` is the nearest built-in name."""

    def __init__(self, name: str) -> None:
        self.suggestion = find_closest_name(name, list_builtin_robots())
        builtin_names = ", ".join(f"`{robot}`" for robot in list_builtin_robots())
        super().__init__(
            f"expected a built-in robot ({builtin_names}) or the path of a robot YAML file, "
            f"got {name!r}" + (URDF_HINT if name.endswith((".urdf", ".xacro")) else NEW_ROBOT_HINT)
        )


def list_builtin_robots() -> list[str]:
    """Return names of the robots that come with the package."""
    directory = files("climbplan").joinpath("robots")
    names = [entry.name for entry in directory.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def read_robot_text(name: str) -> str:
    """Return the YAML text of a built-in robot."""
    if name not in list_builtin_robots():
        raise UnknownRobot(name)
    return files("climbplan").joinpath("robots", f"{name}.yaml").read_text(encoding="utf-8")


def load_robot(reference: str | Path, directory: Path | None = None) -> RobotSpec:
    """Load a robot of coxa, femur and tibia by built-in name, or from a YAML file.

    Args:
        reference: Built-in name, or path of a file that ends in .yaml or .yml.
        directory: Directory that a path starts from; None is the current one.

    Raises:
        UnknownRobot: `reference` is neither a YAML file's name nor a built-in one.
        SpecError: the file cannot be used; with its own lines; or it names a URDF.
    """
    robot = load_any_robot(reference, directory)
    if isinstance(robot, UrdfRobot):
        raise robot.build_error([Finding(("urdf",), NO_CHAINS)])
    return robot


def load_any_robot(reference: str | Path, directory: Path | None = None) -> AnyRobot:
    """Load a robot with limbs of any kind by built-in name, or from a YAML file.

    Args:
        reference: Built-in name, or path of a file that ends in .yaml or .yml.
        directory: Directory that a path starts from; None is the current one.

    Raises:
        UnknownRobot: `reference` is neither a YAML file's name nor a built-in one.
        SpecError: the file, or the URDF that it names, cannot be used; with its own lines.
    """
    name = str(reference)
    if Path(name).suffix not in (".yaml", ".yml"):
        return build_robot(parse_yaml(read_robot_text(name), f"robot {name}"), Path())
    source = read_source((directory or Path()) / name)
    return build_robot(parse_yaml(source.text, source.shown), source.directory)


def find_robot_files(reference: str, directory: Path) -> list[Path]:
    """Return the file of a robot or rigid body, followed by the URDF that it names, if any.

    Args:
        reference: Path of the YAML file.
        directory: Directory that the path starts from.

    Raises:
        SpecError: the file cannot be read.
    """
    path = directory / reference
    value = parse_yaml(read_source(path).text, str(path)).value
    urdf = value.get("urdf") if isinstance(value, dict) else None
    return [path, path.parent / urdf] if isinstance(urdf, str) else [path]


def build_robot_from_text(document: Document, text: SourceText) -> AnyRobot:
    """Build a robot from a document; paths in it start from the directory of its source text."""
    return build_robot(document, text.directory)


def build_robot(document: Document, directory: Path) -> AnyRobot:
    """Return the robot that a document describes.

    Args:
        document: A parsed robot file.
        directory: Directory that paths in it start from.

    Raises:
        SpecError: with every mistake in it.
    """
    findings: list[Finding] = []
    kind = find_kind(document, expected_kind="robot")
    if isinstance(kind, Finding):
        findings.append(kind)
    robot: AnyRobot | None
    if isinstance(document.value, dict) and "urdf" in document.value:
        spec, document_findings = validate(document, UrdfRobotSpec)
        robot = None
        if spec is not None:
            from climbplan.schema.robots.urdf.source import build_urdf_robot

            robot, urdf_findings = build_urdf_robot(spec, document, (), directory)
            document_findings = [*document_findings, *urdf_findings]
    else:
        robot, document_findings = validate(document, RobotSpec)
    findings += [f for f in document_findings if f.path != ("kind",)]
    if robot is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return robot
