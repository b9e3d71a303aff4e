"""Load an MPC spec with overrides and its robot, and report all mistakes together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from pydantic import ValidationError

from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import validate, validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.rigid_body import RigidBodySpec
from climbplan.schema.robots.source import build_robot
from climbplan.schema.robots.stored import NotKept, RobotTexts, build_stored_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.wording import format_value
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.schema.loop import WalkLoopSpec
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkTaskSpec

WalkingRobot = RigidBodySpec | UrdfRobot
_LIMBS = (
    "expected a rigid body (`kind: rigid-body`) or the robot file of a URDF, got limbs of coxa, "
    "femur and tibia, whose links have no masses"
)


@dataclass(frozen=True, kw_only=True)
class LoadedMpc(LoadedSpec):
    """An MPC spec, checked against its robot, and its source text."""

    spec: MpcSpec
    robot: WalkingRobot
    robot_text: str = ""  # content of the robot file; empty for a built-in robot
    robot_urdf: str = ""  # content of its URDF

    def with_overrides(self, overrides: Sequence[str | Override]) -> LoadedMpc:
        """Return the same walk with other values.

        Raises:
            SpecError: with every mistake that the overrides cause.
        """
        text = SourceText(self.source, self.name, self.directory, self.text)
        return validate_mpc(apply_overrides(self.document, overrides), text)


def load_mpc(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedMpc:
    """Read, override and check an MPC spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec, overrides and robot file.
    """
    text = read_source(source)
    return validate_mpc(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def validate_mpc(document: Document, text: SourceText) -> LoadedMpc:
    """Validate a document as an MPC spec.

    Raises:
        SpecError: with every mistake in it and in its robot file.
    """
    value = document.value
    robot_path = isinstance(value, dict) and _is_path(value.get("robot"))
    paths = (("library", "file"), ("terrain", "scan", "file"))
    resolve_option_paths(document, (*paths, *([("robot",)] if robot_path else [])))
    spec, findings = validate_kind(document, "mpc", MpcSpec)
    robot, robot_mistakes = load_document_body(document, text.directory)
    findings += _check_leg_names(document, robot)
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or robot is None or mistakes:
        raise SpecError(document.source, mistakes)
    source = read_source(text.directory / spec.robot).text if robot_path else ""
    urdf = robot.tree.text if isinstance(robot, UrdfRobot) else ""
    return LoadedMpc(
        spec=spec,
        robot=robot,
        robot_text=source,
        robot_urdf=urdf,
        **describe_origin(document, text),
    )


def list_builtin_bodies() -> list[str]:
    """List the rigid bodies that come with the package."""
    folder = files("climbplan").joinpath("robots", "bodies")
    names = [entry.name for entry in folder.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def load_body(reference: str, directory: Path | None = None) -> WalkingRobot:
    """Load a walking robot by built-in name, or from a YAML file relative to `directory`.

    Raises:
        SpecError: the file cannot be used; with its own lines.
    """
    if _is_path(reference):
        source = read_source((directory or Path()) / reference)
        document = parse_yaml(source.text, source.shown)
        if isinstance(document.value, dict) and document.value.get("kind") == "robot":
            robot = build_robot(document, source.directory)
            if isinstance(robot, UrdfRobot):
                return robot
            raise SpecError(document.source, [document.mistake(Finding(("kind",), _LIMBS))])
    elif reference not in list_builtin_bodies():
        known_names = ", ".join(list_builtin_bodies())
        message = f"expected a built-in robot ({known_names}) or the path of a YAML file, got"
        mistake = SpecMistake("robot", f"{message} {format_value(reference)}")
        raise SpecError("spec", [mistake])
    else:
        entry = files("climbplan").joinpath("robots", "bodies", f"{reference}.yaml")
        document = parse_yaml(entry.read_text(encoding="utf-8"), f"robot {reference}")
    return _validate_body(document)


def load_stored_body(spec: MpcSpec, text: str, urdf: str = "") -> WalkingRobot:
    """Load the robot of a spec from the texts of a plan file.

    Raises:
        SpecError: the texts are no robot.
    """
    if not _is_path(spec.robot):
        return load_body(spec.robot)
    document = parse_yaml(text, f"robot {spec.robot}")
    if not (isinstance(document.value, dict) and "urdf" in document.value):
        return _validate_body(document)
    named = Document(document.source, document.text, {"robot": spec.robot})
    try:
        robot = build_stored_robot(named, RobotTexts(text, urdf)).robot
    except NotKept as reason:
        raise SpecError(document.source, [SpecMistake("robot", str(reason))]) from reason
    assert isinstance(robot, UrdfRobot)  # as its text names a URDF
    return robot


def _is_path(reference: object) -> bool:
    return isinstance(reference, str) and Path(reference).suffix in (".yaml", ".yml")


def _validate_body(document: Document) -> RigidBodySpec:
    """Validate a document as a rigid body."""
    findings = []
    if not isinstance(document.value, dict) or document.value.get("kind") != "rigid-body":
        findings.append(Finding(("kind",), "expected `kind: rigid-body`"))
    body, body_findings = validate(document, RigidBodySpec)
    findings += [f for f in body_findings if f.path != ("kind",)]
    if body is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return body


def load_document_body(
    document: Document, directory: Path, path: KeyPath = ("robot",)
) -> tuple[WalkingRobot | None, list[SpecMistake]]:
    """Load the robot that a document names; return what is wrong with it or its file."""
    holder = document.value
    for key in path[:-1]:
        holder = holder.get(key, {}) if isinstance(holder, dict) else {}
    reference = holder.get(path[-1], "scaler") if isinstance(holder, dict) else None
    if not isinstance(reference, str) or not reference:
        return None, []  # the model says what is wrong with it
    known_names = list_builtin_bodies()
    if reference not in known_names and Path(reference).suffix not in (".yaml", ".yml"):
        listed = ", ".join(f"`{name}`" for name in known_names)
        message = (
            f"expected a built-in rigid body ({listed}) or the path of a YAML file, of a rigid "
            f"body or of a robot from a URDF, got {format_value(reference)}"
        )
        return None, [
            document.mistake(Finding(path, message, find_closest_name(reference, known_names)))
        ]
    try:
        return load_body(reference, directory), []
    except SpecError as error:
        return None, [
            # Without a line the file itself is at fault, and so the key that names it.
            replace(m, source=m.source or error.source)
            if m.line
            else document.mistake(Finding(path, f"{error.source}: {m.message}", m.suggestion))
            for m in error.mistakes
        ]


def _check_leg_names(document: Document, robot: WalkingRobot | None) -> list[Finding]:
    """Check that toes of the start and lost contacts name legs of the robot."""
    if robot is None:
        return []
    try:
        task = WalkTaskSpec.model_validate(document.value.get("task", {}))
    except ValidationError:
        return []  # reported with the whole
    legs = list(robot.limb_names if isinstance(robot, UrdfRobot) else robot.legs)
    try:
        loop = WalkLoopSpec.model_validate(document.value.get("loop", {}))
    except ValidationError:
        return []
    named: list[tuple[tuple[str | int, ...], str]] = []
    named += [(("task", "start", "toes", name), name) for name in task.start.toes]
    named += _list_legs_of_terrain(document)
    named += [
        (("loop", "lost_contacts", k, "leg"), e.leg) for k, e in enumerate(loop.lost_contacts)
    ]
    return [
        Finding(
            path,
            f"{robot.name} has no leg {name!r}, its legs are {', '.join(legs)}",
            find_closest_name(name, legs),
        )
        for path, name in named
        if name not in legs
    ]


def _list_legs_of_terrain(document: Document) -> list[tuple[tuple[str | int, ...], str]]:
    """Return the keys of legs that regions and boxes name, with their names."""
    terrain = document.value.get("terrain")
    named: list[tuple[tuple[str | int, ...], str]] = []
    for group in ("regions", "boxes"):
        entries = terrain.get(group) if isinstance(terrain, dict) else None
        for k, entry in enumerate(entries if isinstance(entries, list) else []):
            limbs = entry.get("limbs") if isinstance(entry, dict) else None
            for n, name in enumerate(limbs if isinstance(limbs, list) else []):
                if isinstance(name, str):
                    named.append((("terrain", group, k, "limbs", n), name))
    return named
