"""Loading of climb specs with overrides: validated model and robot, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.climb.schema.checks import (
    ValidClimbParts,
    check_parts,
    check_risk,
    check_study,
)
from climbplan.climb.schema.model import ClimbSpec, PosturePlannerSpec, SolverSpec, TaskSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import load_robot_of_document, validate_part
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.stored import CarriedRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedClimb(LoadedSpec):
    """A climb spec, checked against its robot, and the text it came from."""

    spec: ClimbSpec
    robot: AnyRobot
    carried_robot: CarriedRobot | None = None  # of a plan, which the robot is from; None: files

    def with_overrides(self, overrides: Sequence[str | Override]) -> LoadedClimb:
        """Return the same climb with other values, for example those of a point of a study.

        Raises:
            SpecError: Lists every mistake that the overrides cause.
        """
        text = SourceText(self.source, self.name, self.directory, self.text)
        return build_climb(apply_overrides(self.document, overrides), text, self.carried_robot)


def load_climb(
    source: str | Path,
    overrides: Sequence[str | Override] = (),
    robot_dir: str | Path | None = None,
) -> LoadedClimb:
    """Read, override and check a climb spec and its robot.

    Args:
        source: A path, or `-` for standard input.
        overrides: Values of dotted keys, `KEY=VALUE`.
        robot_dir: Where a robot given by path is looked up; None for the directory of the spec, or
            the current one for standard input.

    Raises:
        SpecError: Lists every mistake in spec, overrides and robot file.
    """
    text = read_source(source)
    if robot_dir is not None:
        text = replace(text, directory=Path(robot_dir))
    return _load(text, overrides)


def load_text(text: str, name: str, overrides: Sequence[str | Override] = ()) -> LoadedClimb:
    """Check a climb spec given as text; a robot's path starts from the current directory.

    Raises:
        SpecError: Lists every mistake in spec, overrides and robot file.
    """
    return _load(SourceText(name, name, Path.cwd(), text), overrides)


def _load(text: SourceText, overrides: Sequence[str | Override]) -> LoadedClimb:
    """Parse, override and build a climb spec."""
    return build_climb(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def load_planned_climb(text: str, name: str, carried_robot: CarriedRobot) -> LoadedClimb:
    """Check the spec of a plan, with the robot files that the plan carries.

    Args:
        text: The spec that the plan carries.
        name: Of the plan.
        carried_robot: The robot that it carries.

    Raises:
        NotKept: The plan does not carry its robot, or a field is missing that meshes tell.
        SpecError: Lists every mistake.
    """
    source = SourceText(name, name, Path.cwd(), text)
    return build_climb(parse_yaml(text, name), source, carried_robot)


def build_climb(
    document: Document, text: SourceText, carried_robot: CarriedRobot | None = None
) -> LoadedClimb:
    """Build the loaded climb of a document.

    Raises:
        SpecError: Lists every mistake in it.
        NotKept: What is carried is not the whole robot.
    """
    spec, robot = _validate_climb(document, text, carried_robot)
    origin = describe_origin(document, text)
    return LoadedClimb(spec=spec, robot=robot, carried_robot=carried_robot, **origin)


def _validate_climb(
    document: Document, text: SourceText, carried_robot: CarriedRobot | None
) -> tuple[ClimbSpec, AnyRobot]:
    """Return spec and robot of a document, or raise SpecError with all mistakes."""
    resolve_option_paths(document, [("task", "start", "plan"), ("terrain", "scan", "file")])
    spec, findings = validate_kind(document, "climb", ClimbSpec)
    robot: AnyRobot | None
    if carried_robot is None:
        robot, robot_mistakes = load_robot_of_document(document, text.directory)
    else:
        robot, robot_mistakes = carried_robot.load(document), []
    findings += check_parts(_collect_valid_parts(document, robot))
    if spec is not None:
        findings += check_study(spec)
    if spec is not None and robot is not None:
        findings += check_risk(spec, robot)
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or robot is None or mistakes:
        raise SpecError(document.source, mistakes)
    return spec, robot


def _collect_valid_parts(document: Document, robot: AnyRobot | None) -> ValidClimbParts:
    """Return the parts of a document that are valid on their own."""
    return ValidClimbParts(
        terrain=validate_part(document, "terrain", TerrainSpec),
        task=validate_part(document, "task", TaskSpec),
        posture=validate_part(document, "posture", PosturePlannerSpec),
        solver=validate_part(document, "solver", SolverSpec),
        robot=robot,
    )
